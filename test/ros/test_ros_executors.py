"""The node in a user's own executor, with one thread or several, while everything is asked of it at once."""

from __future__ import annotations

import contextlib
import json
import random
import threading
import time

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from mini_data import POSES, scan_room
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import QoSProfile
from ros_bench import SECOND, Host, cloud
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from yardstick import PATIENCE_S

from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import own_domain_id
from svc_ros.ros.registration_node import RegistrationNode

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k)[::3] for k, T in enumerate(POSES)]
SECONDS = 6.0
SERVICES = {"verify": Trigger, "reset": Trigger, "status": Trigger, "enable": SetBool, "change_state": ChangeState}
# Round and round: a stop and go, and then everything anew.
ROUND = (
    Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE,
    Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
)  # fmt: skip


@pytest.fixture
def host(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(85))) as host:
        yield host


class OwnThread:
    """An executor that spins a node on a thread; `errors` is what came out of it."""

    def __init__(self, executor, node) -> None:
        self._executor, self._node, self.errors = executor, node, []
        executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_exception) -> None:
        self._executor.shutdown(timeout_sec=PATIENCE_S)
        self._thread.join(PATIENCE_S)
        self._executor.remove_node(self._node)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except Exception as error:
            self.errors.append(error)


class Crowd:
    """Publishes clouds, most of them in pairs, and calls services in between, by chance."""

    def __init__(self, host: Host, num_transitions: int) -> None:
        self._host, self._random = host, random.Random(1)
        self._pubs = [
            host.node.create_publisher(PointCloud2, f"/{side}_points", QoSProfile(depth=100))
            for side in ("source", "target")
        ]
        self._clients = {
            name: host.node.create_client(kind, f"/svc_registration/{name}") for name, kind in SERVICES.items()
        }
        self._transitions = iter(ROUND * num_transitions)
        self._change = None
        self.statuses, self.num_changed = [], 0
        assert spin_until(host.executor, lambda: all(p.get_subscription_count() for p in self._pubs), PATIENCE_S)
        assert spin_until(host.executor, lambda: all(c.service_is_ready() for c in self._clients.values()), PATIENCE_S)

    def publish(self, stamp_s: float) -> None:
        assert spin_until(self._host.executor, lambda: all(p.get_subscription_count() for p in self._pubs), PATIENCE_S)
        self._pubs[0].publish(cloud(SCANS[1], stamp_s))
        self._pubs[1].publish(cloud(SCANS[0], stamp_s))

    def step(self, stamp_s: float) -> None:
        self._pubs[0].publish(cloud(SCANS[1], stamp_s))
        if self._random.random() < 0.9:
            self._pubs[1].publish(cloud(SCANS[0], stamp_s))
        chance = self._random.random()
        if chance < 0.15:
            self._clients[self._random.choice(["verify", "reset"])].call_async(Trigger.Request())
        elif chance < 0.2:
            self._clients["enable"].call_async(SetBool.Request(data=self._random.random() < 0.7))
        elif chance < 0.5:
            self._clients["status"].call_async(Trigger.Request()).add_done_callback(self._keep_status)
        elif chance < 0.7 and (self._change is None or self._change.done()):
            self._begin_change()
        spin_until(self._host.executor, lambda: False, self._random.choice([0.002, 0.01, 0.03]))

    @property
    def has_been_heard(self) -> bool:
        """True if enough happened in between."""
        return self.num_changed >= 2 and len(self.statuses) >= 3

    def _begin_change(self) -> None:
        request = ChangeState.Request(transition=Transition(id=next(self._transitions)))
        self._change = self._clients["change_state"].call_async(request)
        self.num_changed += 1

    def _keep_status(self, future) -> None:
        self.statuses.append(json.loads(future.result().message))


def wrong_counts(status) -> list[str]:
    jobs, pairing = status["jobs"], status["pairing"]
    matched, unmatched = pairing["matched"], pairing["unmatched"]
    sums = {
        "jobs": (jobs["received"], jobs["pending"] + sum(status["decisions"].values())),
        "clouds": (sum(status["received"].values()), 2 * matched + unmatched + pairing["waiting"]),
        "pairs": (jobs["received"], matched + unmatched),
    }
    return [f"{name}: {left} is not {right}" for name, (left, right) in sums.items() if left != right]


@pytest.mark.parametrize("kind", [SingleThreadedExecutor, MultiThreadedExecutor], ids=["single", "multi"])
def test_clouds_services_and_transitions_at_once_break_nothing(host, kind):
    node = host.start(process_every=False, pair_timeout=0.5)
    host.executor.remove_node(node)
    collector = DecisionCollector(host.node, host.executor)
    with OwnThread(kind(context=host.context), node) as own:
        crowd, stamp, end = Crowd(host, 100), 1.0, time.monotonic() + SECONDS
        while (time.monotonic() < end or not crowd.has_been_heard) and not own.errors:
            crowd.step(stamp := stamp + 0.1)
        spin_until(host.executor, lambda: False, 1.0)
        assert own.errors == []
    assert crowd.has_been_heard
    assert [line for status in crowd.statuses for line in wrong_counts(status)] == []
    host.executor.add_node(node)
    make_active(host)
    crowd.publish(1.0e6)
    assert collector.wait_for_decision_on(1_000_000 * SECOND, PATIENCE_S)
    (decision,) = [d for d in collector.answers.decisions if d["source_stamp"] == "1000000.000000000"]
    assert decision["verdict"] == "accepted", decision


def make_active(host: Host) -> None:
    if host.state() == "unconfigured":
        assert host.change(Transition.TRANSITION_CONFIGURE)
    if host.state() == "inactive":
        assert host.change(Transition.TRANSITION_ACTIVATE)
    assert host.call(SetBool, "/svc_registration/enable", SetBool.Request(data=True)).success
    assert host.call(Trigger, "/svc_registration/reset", Trigger.Request()).success
    assert spin_until(host.executor, lambda: host.status()["jobs"]["pending"] == 0, PATIENCE_S)


@pytest.mark.parametrize("kind", [SingleThreadedExecutor, MultiThreadedExecutor], ids=["single", "multi"])
def test_started_and_ended_at_once_again_and_again_it_leaves_nothing_behind(host, kind):
    node = host.start(autostart=False)
    host.executor.remove_node(node)
    threads = nodes_threads()
    before = num_entities(node)
    changes = (node.trigger_configure, node.trigger_activate, node.trigger_deactivate, node.trigger_cleanup)
    with OwnThread(kind(context=host.context), node) as own:
        for change in changes * 5:
            change()
        assert own.errors == []
        after = num_entities(node)
    assert after == before
    assert not nodes_threads() - threads


def nodes_threads() -> set[threading.Thread]:
    return {t for t in threading.enumerate() if t.name in ("registration", "decisions", "map frame")}


def num_entities(node: RegistrationNode) -> list[int]:
    return [len(list(entities)) for entities in (node.publishers, node.subscriptions, node.services, node.timers)]


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"qos_overrides./target_points.subscription.reliability": "reliabel"}, "reliabel"),
        ({"mode": "loop_closure", "edges": "pose_graph_tools"}, "pose_graph_tools_msgs"),
    ],
    ids=["an override that is none", "a package that is not there"],
)
def test_what_cannot_be_configured_leaves_nothing_behind(host, capfd, parameters, problem):
    node = host.start(autostart=False, **parameters)
    threads = nodes_threads()
    before = num_entities(node)
    for _ in range(2):
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert num_entities(node) == before
        assert nodes_threads() <= threads
    assert capfd.readouterr().err.count(problem) == 2
