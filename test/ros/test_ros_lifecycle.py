"""The node class in the user's own process: lifecycle, several nodes at once, faults in the worker, simulated time."""

from __future__ import annotations

import contextlib
import copy
import sys
import threading
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from mini_data import POSES, scan_room  # noqa: E402
from rclpy.qos import QoSProfile, qos_profile_sensor_data  # noqa: E402
from ros_bench import SECOND, Host, cloud  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from yardstick import PATIENCE_S  # noqa: E402

from svc_ros.core.errors import ConfigError, MissingDependencyError  # noqa: E402
from svc_ros.ros.bag_player import CloudPlayer  # noqa: E402
from svc_ros.ros.collector import DecisionCollector, spin_until  # noqa: E402
from svc_ros.ros.processes import own_domain_id  # noqa: E402

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


@pytest.fixture
def host(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(30))) as host:
        yield host


class Pairs:
    """Plays pairs to the node, and collects its decisions."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self.collector = DecisionCollector(host.node, host.executor)
        self._player = CloudPlayer(host.node, host.executor, "/source_points", "/target_points")
        assert self._player.wait_for_subscribers(PATIENCE_S)

    def publish(self, source: PointCloud2, target: PointCloud2) -> None:
        self._player.publish(source, target)
        spin_until(self._host.executor, lambda: False, 0.02)  # not faster than the node's inputs hold

    def publish_source(self, source: PointCloud2) -> None:
        publisher = self._host.node.create_publisher(PointCloud2, "/source_points", QoSProfile(depth=10))
        assert spin_until(self._host.executor, publisher.get_subscription_count, PATIENCE_S)
        publisher.publish(source)

    def decide(self, stamp_s: float):
        before = len(self.collector.answers.decisions)
        self._player.publish(cloud(SCANS[1], stamp_s), cloud(SCANS[0], stamp_s))
        assert self.collector.wait_for_decisions(before + 1, PATIENCE_S)
        return self.collector.answers.decisions[-1]


def test_without_autostart_the_node_waits_for_its_transitions(host, monkeypatch):
    monkeypatch.setattr(sys, "setswitchinterval", (intervals := []).append)
    node = host.start(autostart=False)
    assert host.state() == "unconfigured"
    assert intervals == []
    assert node.subscriptions == [] or all("points" not in s.topic_name for s in node.subscriptions)
    assert host.change(Transition.TRANSITION_CONFIGURE)
    assert host.state() == "inactive"
    assert intervals == [0.001]  # the executor would wait for the worker's calls too long
    pairs = Pairs(host)
    assert pairs.decide(1.0)["reason"] == "inactive"
    assert host.change(Transition.TRANSITION_ACTIVATE)
    assert pairs.decide(2.0)["verdict"] == "accepted"
    assert host.change(Transition.TRANSITION_DEACTIVATE)
    assert pairs.decide(3.0)["reason"] == "inactive"


def test_cleanup_gives_everything_back_and_the_node_can_be_configured_again(host):
    node = host.start()
    assert host.state() == "active"
    assert Pairs(host).decide(1.0)["verdict"] == "accepted"
    assert host.change(Transition.TRANSITION_DEACTIVATE)
    assert host.change(Transition.TRANSITION_CLEANUP)
    assert not [s.topic_name for s in node.subscriptions if "points" in s.topic_name]
    assert not [p.topic_name for p in node.publishers if "svc_registration" in p.topic_name]
    assert not [s.srv_name for s in node.services if "status" in s.srv_name]
    assert host.change(Transition.TRANSITION_CONFIGURE)
    assert host.change(Transition.TRANSITION_ACTIVATE)
    assert Pairs(host).decide(2.0)["verdict"] == "accepted"
    assert host.status()["jobs"]["received"] == 1
    assert host.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert host.state() == "finalized"


def test_cleanup_in_the_middle_of_work_answers_everything_that_came(host):
    host.start()
    pairs = Pairs(host)
    assert pairs.decide(1.0)["verdict"] == "accepted"
    for stamp in range(2, 12):
        pairs.publish(cloud(SCANS[1] + 0.001 * stamp, stamp), cloud(SCANS[0] + 0.001 * stamp, stamp))
    pairs.publish_source(cloud(SCANS[1], 12.0))
    assert spin_until(host.executor, lambda: host.status()["received"]["source"] == 12, PATIENCE_S)
    assert host.change(Transition.TRANSITION_DEACTIVATE)
    assert host.change(Transition.TRANSITION_CLEANUP)
    assert pairs.collector.wait_for_decisions(12, PATIENCE_S)
    spin_until(host.executor, lambda: False, 0.5)
    decisions = pairs.collector.answers.decisions
    assert [d["source_stamp"] for d in decisions if d["target_stamp"]] == [f"{s}.000000000" for s in range(1, 12)]
    (alone,) = [d for d in decisions if not d["target_stamp"]]
    assert (alone["source_stamp"], alone["verdict"], alone["reason"]) == ("12.000000000", "dropped", "stale")
    assert decisions[-2]["reason"] == "inactive"


def test_services_that_wait_when_the_node_is_cleaned_up_are_answered(host):
    host.start()
    pairs = Pairs(host)
    assert pairs.decide(1.0)["verdict"] == "accepted"
    names = ("verify", "reset", "change_state")
    kinds = (Trigger, Trigger, ChangeState)
    clients = [
        host.node.create_client(kind, f"/svc_registration/{name}") for kind, name in zip(kinds, names, strict=True)
    ]
    assert spin_until(host.executor, lambda: all(client.service_is_ready() for client in clients), PATIENCE_S)
    for stamp in range(2, 8):
        pairs.publish(cloud(SCANS[1] + 0.001 * stamp, stamp), cloud(SCANS[0] + 0.001 * stamp, stamp))
    verify, reset, change = clients
    answers = [client.call_async(Trigger.Request()) for client in (verify, reset, verify)]
    transitions = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    changes = [change.call_async(ChangeState.Request(transition=Transition(id=t))) for t in transitions]
    assert spin_until(host.executor, lambda: all(f.done() for f in (*answers, *changes)), PATIENCE_S)
    assert all(change.result().success for change in changes)
    texts = [answer.result().message for answer in answers if not answer.result().success]
    assert set(texts) <= {"the node was cleaned up or shut down"}
    (node,) = host.nodes
    assert spin_until(
        host.executor, lambda: not [s for s in node.services if s.srv_name.endswith(("verify", "status"))], 5.0
    )
    assert host.change(Transition.TRANSITION_CONFIGURE)
    assert host.change(Transition.TRANSITION_ACTIVATE)
    assert pairs.decide(100.0)["verdict"] == "accepted"


def test_what_prevents_the_configuration_is_raised_or_said_and_the_node_stays_unconfigured(host, capfd):
    with pytest.raises(MissingDependencyError, match="sensor_frame needs tf2_ros"):
        host.start("raised", sensor_frame="lidar")
    with pytest.raises(ConfigError, match="did you mean 'pair'"):
        host.start("refused", mode="pairs")
    host.start(sensor_frame="lidar", autostart=False)
    assert not host.change(Transition.TRANSITION_CONFIGURE)
    assert host.state() == "unconfigured"
    assert "cannot be configured: sensor_frame needs tf2_ros" in capfd.readouterr().err


@pytest.mark.parametrize("mode", ["scan_matching", "loop_closure"])
def test_motion_without_its_package_says_what_to_install(host, monkeypatch, mode):
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(MissingDependencyError, match="pip install 'kiss-icp"):
        host.start(mode=mode)


def test_nodes_of_all_modes_live_in_one_process(host):
    told = set()

    def on_diagnostics(message):
        told.update(s.name.removesuffix(": worker") for s in message.status if s.name.endswith(": worker"))

    host.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    host.start("pairs")
    host.start("motion", mode="scan_matching")
    host.start("loops", mode="loop_closure")
    assert spin_until(host.executor, lambda: told == {"pairs", "motion", "loops"}, PATIENCE_S)
    collectors = [DecisionCollector(host.node, host.executor, f"/{name}") for name in ("pairs", "motion")]
    player = CloudPlayer(host.node, host.executor, "/source_points", "/target_points")
    points = host.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=10))
    assert player.wait_for_subscribers(PATIENCE_S)
    assert spin_until(host.executor, lambda: points.get_subscription_count() == 2, PATIENCE_S)
    player.publish(cloud(SCANS[1], 1.0), cloud(SCANS[0], 1.0))
    points.publish(cloud(SCANS[0], 1.0))
    for collector in collectors:
        assert collector.wait_for_decisions(1, PATIENCE_S)
        assert collector.answers.decisions[0]["verdict"] == "accepted"
    assert spin_until(host.executor, lambda: host.status("loops")["worker"]["keyframes"] == 1, PATIENCE_S)
    assert [host.status(name)["mode"] for name in ("pairs", "motion", "loops")] == [
        "pair", "scan_matching", "loop_closure"
    ]  # fmt: skip


def test_an_exception_in_the_worker_is_a_decision_and_the_next_pair_is_served(host, monkeypatch):
    node = host.start()
    pairs = Pairs(host)
    assert pairs.decide(1.0)["verdict"] == "accepted"

    def broken(*_args):
        raise RuntimeError("out of cheese")

    with monkeypatch.context() as patch:
        patch.setattr(node._session.engine, "process", broken)
        decision = pairs.decide(2.0)
    assert (decision["verdict"], decision["reason"]) == ("rejected", "internal_error")
    assert decision["detail"] == "RuntimeError: out of cheese"
    assert pairs.decide(3.0)["verdict"] == "accepted"
    assert host.status()["jobs"] == {"received": 3, "pending": 0, "without_candidate": 0}


def wait_for_readers(host, *publishers) -> None:
    assert spin_until(host.executor, lambda: all(p.get_subscription_count() for p in publishers), PATIENCE_S)


@pytest.mark.parametrize("in_time", [True, False], ids=["clock-first", "cloud-first"])
def test_a_clock_that_jumps_back_begins_anew_once(host, in_time):
    node = host.start(mode="scan_matching", use_sim_time=True)
    clock = host.node.create_publisher(Clock, "/clock", QoSProfile(depth=10))
    points = host.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=10))
    collector = DecisionCollector(host.node, host.executor)
    wait_for_readers(host, clock, points)

    def tick(seconds):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
        assert spin_until(host.executor, lambda: node.get_clock().now().nanoseconds == seconds * SECOND, PATIENCE_S)

    def origin(stamp_s):
        before = len(collector.answers.decisions)
        points.publish(cloud(SCANS[0], stamp_s))
        assert collector.wait_for_decisions(before + 1, PATIENCE_S)
        return collector.answers.decisions[-1]["origin"]

    tick(100)
    assert [origin(99.8), origin(99.9)] == ["start", "motion"]
    if in_time:
        tick(50)
        assert origin(49.9) == "start"
    else:
        assert origin(49.9) == "start"
        tick(50)
    assert origin(50.0) == "motion"


def test_diagnostics_come_once_a_second_while_simulated_time_stands_still(host):
    host.start(use_sim_time=True)
    times = []
    host.node.create_subscription(DiagnosticArray, "/diagnostics", lambda _: times.append(time.monotonic()), 10)
    assert spin_until(host.executor, lambda: len(times) >= 4, PATIENCE_S)
    assert 0.7 < np.median(np.diff(times)) < 1.5


def test_pairs_that_wait_when_the_clock_jumps_back_are_stale(host):
    node = host.start(use_sim_time=True)
    clock = host.node.create_publisher(Clock, "/clock", QoSProfile(depth=10))
    source = host.node.create_publisher(PointCloud2, "/source_points", QoSProfile(depth=10))
    collector = DecisionCollector(host.node, host.executor)
    wait_for_readers(host, clock, source)
    for seconds in (100, 50):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
        assert spin_until(host.executor, lambda s=seconds: node.get_clock().now().nanoseconds == s * SECOND, PATIENCE_S)
        if seconds == 100:
            source.publish(cloud(SCANS[1], 99.9))
            assert spin_until(host.executor, lambda: host.status()["received"]["source"] == 1, PATIENCE_S)
    assert collector.wait_for_decisions(1, PATIENCE_S)
    (decision,) = collector.answers.decisions
    assert (decision["verdict"], decision["reason"]) == ("dropped", "stale")


def test_overrides_of_one_node_stay_with_that_node(host):
    before = copy.copy(qos_profile_sensor_data)
    host.start("first", mode="scan_matching", **{"qos_overrides./points.subscription.depth": 77})
    of_second = {"qos_overrides./points.subscription.reliability": "best_effort"}
    second = host.start("second", mode="scan_matching", process_every=False, **of_second)
    (points,) = [s for s in second.subscriptions if s.topic_name == "/points"]
    assert (points.qos_profile.reliability, points.qos_profile.depth) == (before.reliability, 20)
    assert qos_profile_sensor_data == before


def test_a_node_that_nobody_stopped_stops_when_it_is_destroyed(host, capfd):
    node = host.start()
    pairs = Pairs(host)
    assert pairs.decide(1.0)["verdict"] == "accepted"
    for stamp in range(2, 8):
        pairs.publish(cloud(SCANS[1] + 0.001 * stamp, stamp), cloud(SCANS[0] + 0.001 * stamp, stamp))
    host.nodes.remove(node)
    host.executor.remove_node(node)
    node.destroy_node()
    names = {thread.name for thread in threading.enumerate()}
    assert not names & {"registration", "decisions"}
    assert pairs.collector.wait_for_decisions(6, PATIENCE_S)  # what it had got is answered
    assert "Traceback" not in capfd.readouterr().err
