"""What goes wrong around a working node: service calls and changes in between, publishers that die or do not fit."""

from __future__ import annotations

import json
import signal

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mini_data import POSES, scan_room
from rclpy.qos import qos_profile_sensor_data
from ros_bench import Bench, cloud
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from yardstick import PATIENCE_S

from svc_ros.ros.bag_player import CloudPlayer
from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        parameters = {"preset": "lidar_indoor", "process_every": "true"}
        with Bench(tmp_path_factory.mktemp("node"), own_domain_id(50), parameters) as bench:
            yield bench


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def burst(bench, first_stamp: int, count: int, stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)):
    """Pairs whose features have to be computed: none is in the cache. Not faster than the middleware takes them.

    A stretched source fits nowhere, and is looked for in vain for a second or so.
    """
    for k in range(count):
        shift = np.array([0.0, 0.0, 0.001 * (first_stamp + k)])
        source = SCANS[1] * np.array(stretch) + shift
        bench.player.publish(cloud(source, first_stamp + k), cloud(SCANS[0] + shift, first_stamp + k))
        bench.pause(0.02)


def wait_for_jobs(bench, count: int) -> None:
    """Wait until the node has received so many pairs since its start."""
    assert spin_until(bench.executor, lambda: bench.status()["jobs"]["received"] == count, PATIENCE_S), told_by(bench)


def told_by(bench) -> str:
    """What the node says of itself where something is missing."""
    return f"{json.dumps(bench.status())}\n{bench.process.output()}"


def test_services_and_parameters_are_served_between_pairs_and_no_pair_is_lost(bench):
    before, num_pairs, moments = len(bench.answers.decisions), 0, []
    while num_pairs < 200 and not any(counts["jobs"]["pending"] > 1 for counts in moments):
        burst(bench, 1000 + num_pairs, 8)
        num_pairs += 8
        moments.append(bench.status())
    assert moments[-1]["jobs"]["pending"] > 1  # there is work in between
    for k in range(6):
        counts = bench.status()
        assert counts["jobs"]["received"] == counts["jobs"]["pending"] + sum(counts["decisions"].values())
        bench.set_parameter("method", "sc2" if k % 2 else "svc")
        if counts["decisions"]["accepted"]:
            answer = bench.call(Trigger, "verify", Trigger.Request())
            assert answer.success, answer.message
            assert json.loads(answer.message)["verdict"] == "accepted"
    bench.set_parameter("method", "svc")
    assert bench.collector.wait_for_decisions(before + num_pairs, PATIENCE_S), told_by(bench)
    bench.settle()
    assert [d["verdict"] for d in bench.answers.decisions[before:]] == ["accepted"] * num_pairs


def test_no_pair_is_lost_that_comes_while_the_node_has_no_processor(bench):
    before = len(bench.answers.decisions)
    bench.process.interrupt(signal.SIGSTOP)
    try:
        burst(bench, 100, 8)
    finally:
        bench.process.interrupt(signal.SIGCONT)
    assert bench.collector.wait_for_decisions(before + 8, PATIENCE_S), told_by(bench)
    assert [d["verdict"] for d in bench.answers.decisions[before:]] == ["accepted"] * 8


def test_pairs_that_wait_when_the_node_is_disabled_or_reset_are_dropped_with_their_reason(bench):
    for first, reason in ((2000, "inactive"), (3000, "stale")):
        before, num_pairs = len(bench.answers.decisions), 0
        came_before = bench.status()["jobs"]["received"]
        while num_pairs < 400 and bench.status()["worker"]["queue"] < 10:  # work for a second and more
            burst(bench, first + num_pairs, 10, stretch=(1.0, 1.6, 1.4))
            num_pairs += 10
            # A cloud whose lost part is repaired comes late; a pair with a half before and one after a reset is none.
            wait_for_jobs(bench, came_before + num_pairs)
        if reason == "inactive":
            assert bench.call(SetBool, "enable", SetBool.Request(data=False)).success
        else:
            assert bench.call(Trigger, "reset", Trigger.Request()).success
        assert bench.collector.wait_for_decisions(before + num_pairs, PATIENCE_S), told_by(bench)
        assert bench.call(SetBool, "enable", SetBool.Request(data=True)).success
        decisions = bench.answers.decisions[before:]
        served = [d for d in decisions if (d["verdict"], d["reason"]) != ("dropped", reason)]
        assert {d["verdict"] for d in served} <= {"rejected", "undecided"}
        assert 1 <= len(served) < num_pairs  # what came before the call
        assert len(decisions) == num_pairs
    assert bench.status()["jobs"]["pending"] == 0


def test_publishers_that_die_are_replaced_by_the_next(bench):
    assert bench.decide(cloud(SCANS[1], 400.0), cloud(SCANS[0], 400.0))["verdict"] == "accepted"
    bench.player.destroy()
    bench.settle()
    bench.player = CloudPlayer(bench.node, bench.executor, "/source_points", "/target_points")
    assert bench.player.wait_for_subscribers(PATIENCE_S)
    assert bench.decide(cloud(SCANS[1], 401.0), cloud(SCANS[0], 401.0))["verdict"] == "accepted"


@pytest.mark.slow
def test_a_publisher_whose_qos_does_not_fit_is_an_error_in_diagnostics(bench):
    found = []

    def on_diagnostics(message):
        found.extend(s for s in message.status if "incompatible QoS" in s.message)

    subscription = bench.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    publisher = bench.node.create_publisher(PointCloud2, "/source_points", qos_profile_sensor_data)
    assert spin_until(bench.executor, lambda: found, PATIENCE_S), bench.process.output()
    bench.node.destroy_publisher(publisher)
    bench.node.destroy_subscription(subscription)
    assert found[0].level == DiagnosticStatus.ERROR
    assert "source_points" in found[0].message
    assert "qos_overrides./source_points" in bench.process.output()
