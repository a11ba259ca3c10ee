"""Clouds in other frames than the sensor's, through the running node; tf2 is a stand-in with a few transforms."""

from __future__ import annotations

import contextlib
import sys
import threading
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mini_data import POSES, scan_room
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_bench import Host, cloud
from sensor_msgs.msg import PointCloud2
from yardstick import PATIENCE_S

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.ros.bag_player import CloudPlayer
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import own_domain_id
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.conversions import transform_message

pytestmark = pytest.mark.dds

MOUNT = np.array([0.1, 0.2, 1.5])
FIRST_S = 100.0
SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


class Tree:
    """What tf2 knows: (target, source) to a translation; a look-up waits for its timeout, or until it is over.

    As in tf2, a static transform is known of all times, another one since it came.
    """

    def __init__(self) -> None:
        self.known = {("base_link", "lidar"): MOUNT}
        self.moving = {}  # (target, source) to the translation as a function of time [s], known since FIRST_S
        self.num_cleared, self.num_listeners = 0, 0
        self.is_over = threading.Event()

    def module(self) -> ModuleType:
        tree = self

        class Buffer:
            def lookup_transform(self, target, source, time, timeout):
                seconds = time.nanoseconds * 1e-9
                if (target, source) in tree.moving and seconds >= FIRST_S:
                    x, y, z = tree.moving[target, source](seconds).tolist()
                elif (target, source) in tree.known:
                    x, y, z = tree.known[target, source].tolist()
                else:
                    tree.is_over.wait(timeout.nanoseconds * 1e-9)
                    raise LookupError("not in the tree")
                turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
                shift = SimpleNamespace(x=x, y=y, z=z)
                return SimpleNamespace(transform=SimpleNamespace(translation=shift, rotation=turn))

            def clear(self):
                tree.num_cleared += 1

        class TransformListener:
            def __init__(self, _buffer, _node):
                tree.num_listeners += 1

            def unregister(self):
                tree.num_listeners -= 1

        module = ModuleType("tf2_ros")
        module.Buffer, module.TransformListener = Buffer, TransformListener
        return module


@pytest.fixture
def tree(monkeypatch):
    tree = Tree()
    monkeypatch.setitem(sys.modules, "tf2_ros", tree.module())
    return tree


@pytest.fixture
def host(monkeypatch, tree):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(95))) as host:
        yield host


class Stream:
    def __init__(self, host: Host) -> None:
        self._host = host
        self._points = host.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=10))
        self._collector = DecisionCollector(host.node, host.executor)
        assert spin_until(host.executor, self._points.get_subscription_count, PATIENCE_S)

    def decide(self, stamp_s: float, frame: str, shift=MOUNT):
        before = len(self._collector.answers.decisions)
        self._points.publish(cloud(SCANS[0] + shift, stamp_s, frame))
        assert self._collector.wait_for_decisions(before + 1, PATIENCE_S)
        return self._collector.answers.decisions[-1]


def test_a_frame_without_tf_is_refused_by_name_and_the_next_scan_goes_on(host, tree):
    host.start(mode="scan_matching", sensor_frame="lidar")
    stream, levels = Stream(host), []

    def on_diagnostics(message):
        levels.extend(s.level for s in message.status if s.name.endswith("decisions"))

    host.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    assert stream.decide(1.0, "base_link")["verdict"] == "accepted"
    lost = stream.decide(1.1, "map")
    assert (lost["verdict"], lost["reason"]) == ("rejected", "tf_unavailable")
    assert lost["detail"].startswith("expected a transform from 'lidar' to 'map' at 1.100000000 s: not in the tree")
    assert spin_until(host.executor, lambda: DiagnosticStatus.ERROR in levels, PATIENCE_S)
    assert stream.decide(1.2, "base_link")["verdict"] == "accepted"
    levels.clear()
    assert spin_until(host.executor, lambda: DiagnosticStatus.OK in levels, PATIENCE_S)


def test_a_look_up_that_waits_leaves_the_executor_alive(host, tree):
    host.start(mode="scan_matching", sensor_frame="lidar", tf_timeout=60.0)
    stream = Stream(host)
    assert stream.decide(1.0, "base_link")["verdict"] == "accepted"
    stream._points.publish(cloud(SCANS[0] + MOUNT, 1.1, "map"))
    assert spin_until(host.executor, lambda: host.status()["jobs"]["pending"] == 1, PATIENCE_S)
    for _ in range(5):
        assert host.status()["jobs"]["pending"] == 1
    tree.is_over.set()
    assert spin_until(host.executor, lambda: host.status()["jobs"]["pending"] == 0, PATIENCE_S)


def test_the_listener_lives_as_long_as_the_node_is_configured(host, tree):
    node = host.start(mode="scan_matching", sensor_frame="lidar")
    assert tree.num_listeners == 1
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert tree.num_listeners == 0


def test_a_configuration_that_fails_halfway_leaves_nothing_behind(host, tree, monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs", None)
    node = host.start(mode="scan_matching", sensor_frame="lidar", publish_tf=True, autostart=False)
    before = [len(list(entities)) for entities in (node.publishers, node.subscriptions, node.services, node.timers)]
    for _ in range(2):
        node.trigger_configure()
    after = [len(list(entities)) for entities in (node.publishers, node.subscriptions, node.services, node.timers)]
    assert after == before
    assert tree.num_listeners == 0


def test_a_sensor_frame_that_is_set_at_work_is_looked_up_or_refused_for_want_of_tf2(host, tree, monkeypatch):
    node = host.start(mode="scan_matching")
    change = [Parameter("sensor_frame", value="lidar")]
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "tf2_ros", None)
        (answer,) = node.set_parameters(change)
    assert not answer.successful
    assert answer.reason.startswith("sensor_frame needs tf2_ros (apt install")
    stream = Stream(host)
    assert stream.decide(1.0, "map")["verdict"] == "accepted"  # still the cloud's own frame
    (answer,) = node.set_parameters(change)
    assert answer.successful
    assert tree.num_listeners == 1
    assert stream.decide(1.1, "map")["reason"] == "tf_unavailable"
    assert stream.decide(1.2, "lidar", shift=0.0)["reason"] == "unsupported_cloud"  # a stream stays with its frame


class PairsInFrames:
    """Two scans of a room that were taken at two places, sent in any frames."""

    def __init__(self, host: Host) -> None:
        self._player = CloudPlayer(host.node, host.executor, "/source_points", "/target_points")
        self._collector = DecisionCollector(host.node, host.executor)
        assert self._player.wait_for_subscribers(PATIENCE_S)

    def decide(self, source, target):
        """Each is points, stamp [s] and frame."""
        before = len(self._collector.answers.decisions)
        self._player.publish(cloud(*source), cloud(*target))
        assert self._collector.wait_for_decisions(before + 1, PATIENCE_S)
        return self._collector.answers.decisions[-1]


def drive(seconds: float) -> np.ndarray:
    """Where the sensor of PairsInFrames is in `odom`: at 0 until 200 s, at 6 m from then on."""
    return np.array([6.0 if seconds >= 200.0 else 0.0, 0.0, 0.0])


@pytest.mark.parametrize("mode", ["pair", "loop_closure"])
def test_two_scans_with_one_stamp_in_a_frame_that_moves_are_refused_with_what_to_do(host, tree, mode):
    tree.moving["odom", "lidar"] = tree.moving["map", "lidar"] = drive
    host.start(mode=mode, sensor_frame="lidar")
    pairs = PairsInFrames(host)
    for frame in ("odom", "map"):
        refused = pairs.decide((SCANS[1], 200.0, "odom"), (SCANS[0], 200.0, frame))
        assert (refused["verdict"], refused["reason"]) == ("rejected", "tf_unavailable")
        assert "both have the stamp 200.000000000 s" in refused["detail"]
        assert "where 'lidar' moves; send them in the sensor's frame" in refused["detail"]
    assert pairs.decide((SCANS[1], 201.0, "lidar"), (SCANS[0], 201.0, "lidar"))["verdict"] == "accepted"


def test_scans_whose_places_tf_has_are_registered(host, tree):
    tree.moving["odom", "lidar"] = drive
    host.start(sensor_frame="lidar", pair_timeout=0.2)
    pairs = PairsInFrames(host)
    at_six = SCANS[1] + drive(200.0)
    static = pairs.decide((SCANS[1] + MOUNT, 200.0, "base_link"), (SCANS[0] + MOUNT, 200.0, "base_link"))
    one_moves = pairs.decide((at_six, 201.0, "odom"), (SCANS[0] + MOUNT, 201.0, "base_link"))
    own_stamps = pairs.decide((at_six, 200.01, "odom"), (SCANS[0], 199.99, "odom"))
    assert [d["verdict"] for d in (static, one_moves, own_stamps)] == ["accepted"] * 3


def test_a_frame_without_tf_is_told_with_its_side(host, tree):
    host.start(sensor_frame="lidar", tf_timeout=0.01)
    lost = PairsInFrames(host).decide((SCANS[1] + MOUNT, 200.0, "base_link"), (SCANS[0], 200.0, "map"))
    assert lost["detail"].startswith("target: expected a transform from 'lidar' to 'map' at 200.000000000 s")


@pytest.mark.parametrize("is_static", [True, False])
def test_real_tf2_tells_static_transforms_from_those_that_move(host, monkeypatch, is_static):
    monkeypatch.delitem(sys.modules, "tf2_ros")
    pytest.importorskip("tf2_ros", reason="needs tf2_ros (apt install ros-jazzy-tf2-ros-py)")
    node = host.start(sensor_frame="lidar")
    buffer = node._session.frames._buffer
    for second in (200, 201):
        message = transform_message(np.eye(4), second * 1_000_000_000, "odom", "lidar")
        (buffer.set_transform_static if is_static else buffer.set_transform)(message, "test")
    labels = (CloudLabel(200_500_000_000, "odom"), CloudLabel(200_500_000_000, "odom"))
    with contextlib.nullcontext() if is_static else pytest.raises(TransformUnavailableError, match="moves"):
        node._session.frames.check_one_stamp(node._svc.settings, *labels)
