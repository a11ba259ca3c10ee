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

from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

MOUNT = np.array([0.1, 0.2, 1.5])
SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


class Tree:
    """What tf2 knows: (target, source) to a translation; a look-up waits for its timeout, or until it is over."""

    def __init__(self) -> None:
        self.known = {("base_link", "lidar"): MOUNT}
        self.num_cleared, self.num_listeners = 0, 0
        self.is_over = threading.Event()

    def module(self) -> ModuleType:
        tree = self

        class Buffer:
            def lookup_transform(self, target, source, _time, timeout):
                if (target, source) not in tree.known:
                    tree.is_over.wait(timeout.nanoseconds * 1e-9)
                    raise LookupError("not in the tree")
                x, y, z = tree.known[target, source].tolist()
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
