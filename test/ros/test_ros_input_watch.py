"""Publishers that do not fit, silence, time that jumps back: what the node says, and that it stops saying so."""

from __future__ import annotations

import contextlib

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from mini_data import POSES, scan_room  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from ros_bench import Host, cloud  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402
from yardstick import PATIENCE_S  # noqa: E402

from svc_ros.core.errors import ConfigError  # noqa: E402
from svc_ros.ros import diagnostics  # noqa: E402
from svc_ros.ros.collector import DecisionCollector, spin_until  # noqa: E402
from svc_ros.ros.diagnostics import InputMonitor, Statistics  # noqa: E402
from svc_ros.ros.processes import own_domain_id  # noqa: E402
from svc_ros.ros.registration_node import RegistrationNode  # noqa: E402
from svc_ros.ros.topics import input_watch  # noqa: E402
from svc_ros.ros.topics.input_watch import InputWatch  # noqa: E402

pytestmark = pytest.mark.dds

POINTS = scan_room(POSES[0], seed=0)
RESOLVED = "/robot/lidar/points"


@pytest.fixture
def host(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(64))) as host:
        yield host


def start(host: Host, **parameters) -> RegistrationNode:
    """A node in a namespace, with a topic of its own."""
    values = {"mode": "scan_matching", "preset": "lidar_indoor", **parameters}
    node = RegistrationNode(
        context=host.context, namespace="robot", cli_args=["--ros-args", "-r", "points:=lidar/points"],
        parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
    )  # fmt: skip
    host.nodes.append(node)
    host.executor.add_node(node)
    return node


def test_a_publisher_that_does_not_fit_is_told_by_its_resolved_topic_until_it_is_gone(host, capfd):
    statuses = []

    def on_diagnostics(message):
        statuses.extend(s for s in message.status if s.name == "robot/svc_registration: input")

    host.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    override = f"qos_overrides.{RESOLVED}.subscription.reliability"
    start(host, **{override: "reliable"})
    publisher = host.node.create_publisher(PointCloud2, RESOLVED, qos_profile_sensor_data)
    assert spin_until(host.executor, lambda: any("incompatible QoS" in s.message for s in statuses), PATIENCE_S)
    told = next(s for s in statuses if "incompatible QoS" in s.message)
    assert told.level == DiagnosticStatus.ERROR
    (value,) = [pair.value for pair in told.values if pair.key == "qos_points"]
    assert f"set {override}:=best_effort" in value
    spin_until(host.executor, lambda: False, 2.5)  # told once, not every second
    host.node.destroy_publisher(publisher)
    statuses.clear()
    assert spin_until(host.executor, lambda: any("incompatible" not in s.message for s in statuses), PATIENCE_S)
    assert "qos_points" not in {pair.key for pair in statuses[-1].values}
    log = capfd.readouterr().err
    assert log.count(f"{RESOLVED}: a publisher's QoS does not fit") == 1
    assert f"{override}:=best_effort" in log
    assert log.count(f"{RESOLVED}: all publishers fit again") == 1


def test_an_override_under_a_name_that_was_remapped_is_warned_of_with_the_right_one(host, capfd):
    start(host, **{"qos_overrides./points.subscription.reliability": "reliable"})
    log = capfd.readouterr().err
    assert "parameter qos_overrides./points.subscription.reliability fits no input" in log
    assert f"did you mean qos_overrides.{RESOLVED}.subscription.reliability?" in log


def test_an_override_that_is_no_policy_is_refused_by_name(host):
    with pytest.raises(ConfigError, match=f"qos_overrides.{RESOLVED}: .*reliabel"):
        start(host, **{f"qos_overrides.{RESOLVED}.subscription.reliability": "reliabel"})


def test_what_differs_from_the_preset_is_one_line_and_nothing_is_none(host, capfd):
    start(host, **{"preprocess.voxel_size_m": 0.25, "max_skew": 0.05})
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "set beside preset" in line]
    assert line.endswith("set beside preset lidar_indoor: preprocess.voxel_size_m 0.25 (not 0.3)")
    host.start("plain", process_every=False)
    assert "set beside preset" not in capfd.readouterr().err


def test_silence_is_told_once_with_what_to_check_and_so_is_its_end(host, capfd, monkeypatch):
    monkeypatch.setattr(input_watch, "STALE_AFTER_S", 0.1)
    start(host)
    spin_until(host.executor, lambda: False, 3.0)
    log = capfd.readouterr().err
    assert log.count(f"no clouds on {RESOLVED} for") == 1
    assert "it has 0 publisher(s)" in log
    assert "-r points:=" in log
    monkeypatch.setattr(input_watch, "STALE_AFTER_S", 3600.0)
    points = host.node.create_publisher(PointCloud2, RESOLVED, QoSProfile(depth=10))
    assert spin_until(host.executor, points.get_subscription_count, PATIENCE_S)
    collector = DecisionCollector(host.node, host.executor, "/robot/svc_registration")
    points.publish(cloud(POINTS, 1.0))
    assert collector.wait_for_decisions(1, PATIENCE_S)
    spin_until(host.executor, lambda: False, 2.5)
    assert capfd.readouterr().err.count(f"clouds come on {RESOLVED}") == 1


def test_a_publisher_that_sends_nothing_is_counted(host, capfd):
    host.node.create_publisher(PointCloud2, "/quiet", QoSProfile(depth=10))
    monitor = InputMonitor()
    statistics = Statistics({})
    assert spin_until(host.executor, lambda: host.node.get_publishers_info_by_topic("/quiet"), PATIENCE_S)
    watch = InputWatch(host.node, statistics, "pair")
    watch.add("quiet", qos_profile_sensor_data, monitor)
    watch.look(monitor._start + diagnostics.STALE_AFTER_S - 0.5)
    assert "no clouds" not in capfd.readouterr().err
    watch.look(monitor._start + diagnostics.STALE_AFTER_S + 0.5)
    assert "no clouds on /quiet for 5 s, it has 1 publisher(s): check that they send" in capfd.readouterr().err


@pytest.mark.parametrize("has_clock", [True, False])
def test_time_that_jumps_back_is_told_once_with_what_is_forgotten(host, capfd, has_clock):
    node = start(host, use_sim_time=has_clock)
    clock = host.node.create_publisher(Clock, "/clock", QoSProfile(depth=10))
    points = host.node.create_publisher(PointCloud2, RESOLVED, QoSProfile(depth=10))
    collector = DecisionCollector(host.node, host.executor, "/robot/svc_registration")
    assert spin_until(host.executor, points.get_subscription_count, PATIENCE_S)
    assert not has_clock or spin_until(host.executor, clock.get_subscription_count, PATIENCE_S)
    for number, seconds in enumerate((100, 50), 1):
        if has_clock:
            message = Clock()
            message.clock.sec = seconds
            clock.publish(message)
            now = seconds * 1_000_000_000
            assert spin_until(host.executor, lambda now=now: node.get_clock().now().nanoseconds == now, PATIENCE_S)
        points.publish(cloud(POINTS, seconds - 0.1))
        assert collector.wait_for_decisions(number, PATIENCE_S)
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "jumped back" in line]
    assert "the clock jumped" in line if has_clock else "the stamps of points jumped" in line
    assert line.endswith("keyframes are forgotten, odometry begins anew")


def test_inputs_whose_stamps_are_apart_jump_each_for_itself(host, capfd):
    watch = InputWatch(host.node, Statistics({}), "loop_closure")
    for k in range(3):
        watch.stamped("points", (100 + k) * 1_000_000_000)
        watch.stamped("source", (50 + k) * 1_000_000_000)
    assert "jumped back" not in capfd.readouterr().err
    watch.stamped("source", 10_000_000_000)
    watch.stamped("target", 10_000_000_000)
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "jumped back" in line]
    assert line.endswith("the stamps of source jumped back: clouds that waited for a partner are forgotten")


def test_decisions_are_told_under_name_and_namespace_as_diagnostics_are(host):
    start(host)
    told = []
    latest = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    host.node.create_subscription(DiagnosticArray, "/robot/svc_registration/decision", told.append, latest)
    points = host.node.create_publisher(PointCloud2, RESOLVED, QoSProfile(depth=10))
    assert spin_until(host.executor, points.get_subscription_count, PATIENCE_S)
    points.publish(cloud(POINTS, 1.0))
    assert spin_until(host.executor, lambda: told, PATIENCE_S)
    (status,) = told[0].status
    assert (status.name, status.hardware_id) == ("robot/svc_registration: decision", "robot/svc_registration")
