"""Checks of who is at both ends of a topic, and what each asks for."""

from __future__ import annotations

from collections.abc import Sequence

from svc_ros.cli.doctor.finding import Finding
from svc_ros.io.heard import Endpoint, Heard


def check_endpoints(heard: Heard) -> list[Finding]:
    """Publishers, as the node's inputs would get on with them, and the subscriptions that are there."""
    findings = [_check_publisher(publisher, heard) for publisher in heard.publishers]
    if len(heard.publishers) > 1:
        advice = (
            "one topic should carry one sensor: its sight lines start in one place, and its scans follow each other"
        )
        findings.append(Finding("publishers", "warn", f"{len(heard.publishers)} on one topic", advice))
    return findings + [_check_subscription(subscription, heard) for subscription in heard.subscriptions]


def _check_publisher(publisher: Endpoint, heard: Heard) -> Finding:
    name = f"publisher {publisher.node}"
    if publisher.type != heard.type:
        advice = f"a topic has one type, here {heard.type}: give each publisher a topic of its own"
        return Finding(name, "warn", publisher.type, advice)
    if publisher.reliability == "best effort":
        advice = "the node's inputs fit as they are, best effort; reliable ones would get nothing"
    else:
        advice = (
            "the node's inputs fit as they are, best effort; for every cloud reliable:=true (launch), or "
            f"{override(heard, 'reliability', 'reliable')}"
        )
    return Finding(name, "ok", _qos(publisher), advice)


def _check_subscription(subscription: Endpoint, heard: Heard) -> Finding:
    name = f"subscription {subscription.node}"
    found = _qos(subscription)
    unfit = [(publisher, misfits(publisher, subscription)) for publisher in heard.publishers]
    for publisher, policies in unfit:
        if policies:
            overrides = " and ".join(override(heard, policy, _qos_of(publisher, policy)) for policy in policies)
            found += f": gets nothing from {publisher.node}, whose clouds are {_qos(publisher)}"
            return Finding(name, "warn", found, f"ask for no more than is offered; a node of this package: {overrides}")
    return Finding(name, "ok", found)


def misfits(publisher: Endpoint, subscription: Endpoint) -> Sequence[str]:
    """Policies of which the subscription asks for more than the publisher offers; then it gets nothing from it."""
    asked = {"reliability": "reliable", "durability": "transient local"}
    offered_less = {"reliability": "best effort", "durability": "volatile"}
    return [
        policy
        for policy in asked
        if _qos_of(subscription, policy) == asked[policy] and _qos_of(publisher, policy) == offered_less[policy]
    ]


def _qos_of(endpoint: Endpoint, policy: str) -> str:
    return endpoint.reliability if policy == "reliability" else endpoint.durability


def _qos(endpoint: Endpoint) -> str:
    depth = f"depth {endpoint.depth}" if endpoint.depth else "depth not told"
    return f"{endpoint.reliability}, {endpoint.durability}, {depth}"


def override(heard: Heard, policy: str, value: str) -> str:
    """What makes an input of the node ask for another policy."""
    return f"-p qos_overrides.{heard.topic}.subscription.{policy}:={value.replace(' ', '_')}"
