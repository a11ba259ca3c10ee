"""Clouds that come as Livox' own message: taken with the times of their points where its package is there, else named.

The driver is in a context of its own, as another process is: one participant knows a topic by one type only.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from livox_messages import fast_cdr, install_livox_package
from mini_data import POSES, pose_between, scan_room
from places import PROJECT_ROOT, SUPPORT
from rclpy.context import Context
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_bench import SECOND, Host, cloud
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from yardstick import PATIENCE_S

from svc_ros.core.se3 import pose_error
from svc_ros.io.clouds.livox import LIVOX_TYPE
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, scan_from_cloud
from svc_ros.ros.collector import DecisionCollector, result_from_decision, spin_until
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id
from svc_ros.ros.topics.cloud_topic import CloudTopic, type_problem, type_to_take

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]
LASER = "sensor_msgs/msg/LaserScan"


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def host():
    with contextlib.closing(Host(own_domain_id(60))) as host:
        yield host


@pytest.fixture
def livox(monkeypatch):
    return install_livox_package(monkeypatch)


class Driver:
    """A node that publishes on one topic, called `livox_lidar_publisher`; gone when the host knows it."""

    def __init__(self, host: Host, kind, topic: str = "/points") -> None:
        self._host, self._topic, self._context = host, topic, Context()
        rclpy.init(context=self._context, domain_id=host.domain_id)
        self._node = Node("livox_lidar_publisher", context=self._context)
        self._publisher = self._node.create_publisher(kind, topic, QoSProfile(depth=10))

    def __enter__(self):
        return self

    def __exit__(self, *_exception) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()
        node, topic = self._host.node, self._topic
        assert spin_until(self._host.executor, lambda: node.count_publishers(topic) == 0, PATIENCE_S)

    def has_reader(self) -> bool:
        return self._publisher.get_subscription_count() > 0

    def send(self, message) -> None:
        self._publisher.publish(message)


def livox_scan(points, stamp_s: float) -> bytes:
    return fast_cdr(points, np.arange(len(points)) * 1000, round(stamp_s * SECOND), "livox")


class Ear:
    """A node with one input, and what came in there."""

    def __init__(self, host) -> None:
        self.clouds, self.problems, self._host = [], {}, host

        def subscribe(source):
            return host.node.create_subscription(
                source.message_class, "points", source.callback, QoSProfile(depth=10), raw=source.is_raw
            )

        self.topic = CloudTopic(host.node, "points", subscribe, self.clouds.append, self.problems)
        host.node.create_timer(0.05, self.topic.look)

    def frame_ids(self) -> set[str]:
        return {each.header.frame_id for each in self.clouds}

    def hear(self, driver: Driver, message):
        num_before = len(self.clouds)
        assert spin_until(self._host.executor, driver.has_reader, PATIENCE_S)
        driver.send(message)
        assert spin_until(self._host.executor, lambda: len(self.clouds) > num_before, PATIENCE_S)
        return scan_from_cloud(self.clouds[-1]).scan


@pytest.mark.dds
def test_a_driver_that_starts_later_is_heard_whatever_it_sends(host, livox):
    ear = Ear(host)
    for _ in range(2):
        with Driver(host, livox) as driver:
            scan = ear.hear(driver, livox_scan(SCANS[0], 5.0))
            np.testing.assert_array_equal(scan.points, SCANS[0].astype(np.float32))
            np.testing.assert_array_equal(scan.point_times_s, np.arange(len(SCANS[0])) * 1000 * 1e-9)
            assert (scan.stamp_ns, scan.frame_id) == (5 * SECOND, "livox")
        with Driver(host, PointCloud2) as driver:
            scan = ear.hear(driver, cloud(SCANS[1], 6.0))
            np.testing.assert_array_equal(scan.points, SCANS[1].astype(np.float32))
            assert scan.point_times_s is None
    assert ear.problems == {}


@pytest.mark.dds
def test_another_thread_may_wait_for_the_subscription_that_is_replaced(host, livox, tmp_path, capfd):
    host.executor.remove_node(host.node)
    host.executor = MultiThreadedExecutor(context=host.context)
    host.executor.add_node(host.node)
    ear = Ear(host)
    for frame_id in ("livox", "other"):
        with driver_process(host, frame_id, tmp_path / frame_id):
            assert spin_until(host.executor, lambda name=frame_id: name in ear.frame_ids(), PATIENCE_S)
        assert spin_until(host.executor, lambda: host.node.count_publishers("/points") == 0, PATIENCE_S)
    assert "cannot be subscribed to" not in capfd.readouterr().err


def driver_process(host: Host, frame_id: str, log: Path) -> ChildProcess:
    """A driver as drivers are. In the process of the host's threads, Fast DDS sometimes does not tell it of readers."""
    path = os.pathsep.join(map(str, (SUPPORT, PROJECT_ROOT)))
    return ChildProcess("cloud_driver", [frame_id], {**local_environment(host.domain_id), "PYTHONPATH": path}, log)


@pytest.mark.dds
def test_what_keeps_the_node_from_subscribing_is_told(host, livox):
    other = host.node.create_subscription(PointCloud2, "points", lambda _: None, QoSProfile(depth=10))
    ear = Ear(host)
    with Driver(host, livox) as driver:
        assert spin_until(host.executor, lambda: ear.problems, PATIENCE_S)
        assert ear.problems["points"].startswith(f"/points: cannot be subscribed to as {LIVOX_TYPE}: ")
        host.node.destroy_subscription(other)
        ear.hear(driver, livox_scan(SCANS[0], 5.0))
    assert spin_until(host.executor, lambda: not ear.problems, PATIENCE_S)


@pytest.mark.dds
def test_a_message_of_which_not_even_the_stamp_is_there_is_left_out(host, livox, capfd):
    ear = Ear(host)
    with Driver(host, livox) as driver:
        assert spin_until(host.executor, driver.has_reader, PATIENCE_S)
        driver.send(livox_scan(SCANS[0], 5.0)[:12])
        ear.hear(driver, livox_scan(SCANS[0], 6.0))
    assert len(ear.clouds) == 1
    assert "/points: truncated message" in capfd.readouterr().err


@pytest.mark.dds
def test_an_input_that_is_given_back_stays_so(host, livox):
    ear = Ear(host)
    ear.topic.destroy()
    with Driver(host, livox) as driver:
        assert spin_until(host.executor, lambda: host.node.count_publishers("/points"), PATIENCE_S)
        ear.topic.look()
        assert not driver.has_reader()
    assert not list(host.node.subscriptions)


@pytest.mark.dds
def test_the_node_registers_pairs_of_livox_scans(host, livox, capfd):
    host.start()
    collector = DecisionCollector(host.node, host.executor)
    with (
        Driver(host, livox, "/source_points") as source,
        Driver(host, livox, "/target_points") as target,
    ):
        assert spin_until(host.executor, lambda: source.has_reader() and target.has_reader(), PATIENCE_S)
        source.send(livox_scan(SCANS[1], 7.0))
        target.send(livox_scan(SCANS[0], 7.0))
        assert collector.wait_for_decisions(1, PATIENCE_S)
        target.send(livox_scan(SCANS[0], 8.0)[:-100])
        source.send(livox_scan(SCANS[1], 8.0))
        assert collector.wait_for_decisions(2, PATIENCE_S)
    good, cut = collector.answers.decisions
    result = result_from_decision(good)
    assert result.accepted
    assert max(pose_error(result.T_target_source, pose_between(1, 0))) < 0.5
    assert (cut["reason"], "truncated data" in cut["detail"]) == ("unsupported_cloud", True)
    assert f"/source_points: clouds are taken as {LIVOX_TYPE}" in capfd.readouterr().err


def input_levels(host):
    """Level and text of the input's status, the newest last."""
    told = []

    def on_diagnostics(message):
        told.extend((s.level, s.message) for s in message.status if s.name.endswith(": input"))

    host.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    return told


@pytest.mark.dds
def test_livox_messages_without_their_package_are_named_until_they_are_gone(host, livox, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "livox_ros_driver2.msg", None)
    host.start(mode="scan_matching")
    told, collector = input_levels(host), DecisionCollector(host.node, host.executor)
    with Driver(host, livox):
        is_told = spin_until(
            host.executor, lambda: sum(level == DiagnosticStatus.ERROR for level, _ in told) == 3, PATIENCE_S
        )
        assert is_told, told
    expected = f"/points: /livox_lidar_publisher publishes {LIVOX_TYPE}, which is not taken: its package is not found"
    assert told[-1][1].startswith(expected)
    assert "xfer_format to 0" in told[-1][1]
    assert capfd.readouterr().err.count(expected) == 1
    with Driver(host, PointCloud2) as driver:
        assert spin_until(host.executor, driver.has_reader, PATIENCE_S)
        driver.send(cloud(SCANS[0], 9.0))
        assert collector.wait_for_decisions(1, PATIENCE_S)
    assert spin_until(host.executor, lambda: told[-1][0] != DiagnosticStatus.ERROR, PATIENCE_S)


@pytest.mark.dds
def test_any_other_type_is_named_too(host):
    host.start(mode="scan_matching")
    told = input_levels(host)
    with Driver(host, String):
        is_told = spin_until(host.executor, lambda: told and told[-1][0] == DiagnosticStatus.ERROR, PATIENCE_S)
        assert is_told, told
    assert told[-1][1] == (
        "/points: /livox_lidar_publisher publishes std_msgs/msg/String, which is not taken: "
        "expected sensor_msgs/msg/PointCloud2"
    )


@pytest.mark.parametrize(
    ("sent", "current", "has_livox", "expected"),
    [
        ([], CLOUD_TYPE, True, CLOUD_TYPE),
        ([LIVOX_TYPE], CLOUD_TYPE, True, LIVOX_TYPE),
        ([LIVOX_TYPE], CLOUD_TYPE, False, CLOUD_TYPE),
        ([], LIVOX_TYPE, False, LIVOX_TYPE),  # the driver starts again
        ([LIVOX_TYPE, CLOUD_TYPE], LIVOX_TYPE, True, CLOUD_TYPE),
        ([LASER], CLOUD_TYPE, True, CLOUD_TYPE),
    ],
)
def test_the_type_follows_the_publishers(sent, current, has_livox, expected):
    assert type_to_take(sent, current, has_livox) == expected


@pytest.mark.parametrize(
    ("senders", "taken", "words"),
    [
        ({}, CLOUD_TYPE, ""),
        ({CLOUD_TYPE: "/a"}, CLOUD_TYPE, ""),
        ({LIVOX_TYPE: "/a"}, LIVOX_TYPE, ""),
        ({LIVOX_TYPE: "/a"}, CLOUD_TYPE, "source the driver's workspace"),
        ({LASER: "/scan"}, CLOUD_TYPE, f"/scan publishes {LASER}"),
        ({CLOUD_TYPE: "/a", LIVOX_TYPE: "/b"}, CLOUD_TYPE, "give each publisher a topic of its own"),
    ],
)
def test_what_is_not_taken_comes_with_what_to_do(senders, taken, words):
    problem = type_problem("/points", senders, taken)
    assert words in problem
    assert bool(problem) == bool(words)
