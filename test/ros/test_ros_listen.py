"""`svc_ros doctor --live` over the middleware: what is heard is what was sent, and who is there."""

from __future__ import annotations

import contextlib
import threading
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

import rclpy
from command_line import assert_refused, run
from livox_messages import fast_cdr, install_livox_package
from mini_data import POSES, scan_room
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_bench import SECOND, cloud
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from yardstick import PATIENCE_S

from svc_ros.cli.doctor import live
from svc_ros.cli.doctor.arrivals import check_age, check_loss
from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import LIVOX_TYPE, NO_LIVOX_PACKAGE
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, scan_from_cloud
from svc_ros.io.heard import Endpoint, Heard
from svc_ros.io.stamps import ns_from_stamp, seconds_and_rest
from svc_ros.ros.collector import spin_until
from svc_ros.ros.ear import Ear, listen
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

POINTS = scan_room(POSES[0])[::20]
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=5)


@pytest.fixture
def domain_id(monkeypatch) -> int:
    """A domain of its own, for programs that are started, too."""
    domain_id = own_domain_id(70)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    return domain_id


@contextlib.contextmanager
def node_on(domain_id: int, name: str):
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = Node(name, context=context, enable_rosout=False, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


class Talker:
    """Publishes what `make(k)` gives, twenty times a second, on a thread; `sent` are the messages so far."""

    def __init__(self, publisher, make) -> None:
        self.sent = []
        self._publisher, self._make, self._is_over = publisher, make, threading.Event()
        self._thread = threading.Thread(target=self._talk)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_exception) -> None:
        self._is_over.set()
        self._thread.join()

    def _talk(self) -> None:
        while not self._is_over.wait(0.05):
            self.sent.append(self._make(len(self.sent)))
            self._publisher.publish(self.sent[-1])


def cloud_now(k: int) -> PointCloud2:
    return cloud(POINTS + 0.001 * k, time.time(), "lidar")


def names(heard: Heard) -> dict[str, str]:
    return {f.name.removeprefix(f"{heard.topic} "): f.level for f in live.check_heard(heard)}


def test_what_is_heard_is_what_was_sent_and_by_whom(domain_id):
    with node_on(domain_id, "driver") as driver:
        driver.create_subscription(PointCloud2, "/lidar/points", lambda _: None, RELIABLE)
        publisher = driver.create_publisher(PointCloud2, "/lidar/points", BEST_EFFORT)
        with Talker(publisher, cloud_now) as talker:
            heard = live.listen("lidar/points", 2.0)
    stamps = [ns_from_stamp(message.header.stamp) for message in talker.sent]
    first = stamps.index(heard.arrivals[0].stamp_ns)
    assert [a.stamp_ns for a in heard.arrivals] == stamps[first : first + len(heard.arrivals)]
    assert len(heard.arrivals) > 5
    assert np.diff([a.sequence for a in heard.arrivals]).tolist() == [1] * (len(heard.arrivals) - 1)
    assert {(a.frame_id, a.num_points, a.clock_ns) for a in heard.arrivals} == {("lidar", len(POINTS), None)}
    assert {a.num_bytes for a in heard.arrivals} <= set(range(12 * len(POINTS), 12 * len(POINTS) + 300))
    assert all(0 < a.received_ns - a.stamp_ns < PATIENCE_S * SECOND for a in heard.arrivals)
    assert (heard.topic, heard.type, heard.num_lost) == ("/lidar/points", CLOUD_TYPE, 0)
    assert heard.publishers == (Endpoint("/driver", CLOUD_TYPE, "best effort", "volatile", 0),)
    assert heard.subscriptions == (Endpoint("/driver", CLOUD_TYPE, "reliable", "volatile", 0),)
    for arrival, message in heard.clouds():
        k = stamps.index(arrival.stamp_ns)
        scan = scan_from_cloud(message).scan
        np.testing.assert_array_equal(scan.points, scan_from_cloud(talker.sent[k]).scan.points)
    told = names(heard)
    assert {"publisher /driver", "rate", "size", "loss", "age", "stamps", "frame", "preset"} <= set(told)
    assert (told["stamps"], told["subscription /driver"]) == ("ok", "warn")
    assert check_loss(heard).found.startswith("0.0%, 0 of ")


def test_what_a_driver_does_wrong_is_told(domain_id):
    def wrong(k: int) -> PointCloud2:
        return cloud(POINTS, 100.0 + k % 5, "map" if k % 2 else "odom")

    with node_on(domain_id, "driver") as driver, Talker(driver.create_publisher(PointCloud2, "/p", RELIABLE), wrong):
        result = run("doctor", "--live", "/p", "--seconds", "2", "--no-trial", "--json", "-")
    assert result.exit_code == 0, result.output
    for words in ("/p stamp order", "/p stamp repeats", "/p repeated clouds", "map", "odom", "counted from its start"):
        assert words in result.stdout


class Pair:
    """A driver and an ear that have found each other; clouds are stamped with their numbers [s]."""

    def __init__(self, driver: Node, node: Node, depth: int) -> None:
        self.ear = Ear(node, "/p", CLOUD_TYPE, 3600.0, depth)
        self._publisher = driver.create_publisher(PointCloud2, "/p", RELIABLE)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self.last = 0
        end = time.monotonic() + PATIENCE_S
        while not self.heard_last(0.2):  # what is sent before both know of each other is for nobody
            assert time.monotonic() < end
            self.send(1)

    def send(self, count: int) -> None:
        for _ in range(count):
            self.last += 1
            self._publisher.publish(cloud(POINTS, float(self.last)))

    def heard_last(self, timeout_s: float = PATIENCE_S) -> bool:
        arrivals = self.ear.arrivals
        return spin_until(
            self._executor, lambda: bool(arrivals) and arrivals[-1].stamp_ns == self.last * SECOND, timeout_s
        )


def test_clouds_that_the_reader_had_no_room_for_are_counted(domain_id):
    with node_on(domain_id, "driver") as driver, node_on(domain_id, "ear") as node:
        pair = Pair(driver, node, depth=3)
        first, num_before = pair.last, len(pair.ear.arrivals)
        pair.send(10)  # while nobody takes them, the last three stay
        assert pair.heard_last()
    arrivals = tuple(pair.ear.arrivals[num_before - 1 :])
    assert [a.stamp_ns // SECOND - first for a in arrivals] == [0, 8, 9, 10]
    driver_end = Endpoint("/driver", CLOUD_TYPE, "reliable", "volatile")
    heard = Heard("/p", 10.0, CLOUD_TYPE, (driver_end,), arrivals=arrivals)
    assert check_loss(heard).found.startswith("63.6%, 7 of 11: sequence numbers leave out 7")


def test_two_in_a_row_are_kept_at_some_moments(domain_id):
    with node_on(domain_id, "driver") as driver, node_on(domain_id, "ear") as node:
        pair = Pair(driver, node, depth=10)
        pair.send(4)
        assert pair.heard_last()
    assert sorted(pair.ear.kept) == [0, 1]


def test_simulated_time_is_what_stamps_are_compared_with(domain_id):
    def clock(k: int) -> Clock:
        message = Clock()
        message.clock.sec, message.clock.nanosec = seconds_and_rest(1000 * SECOND + k * SECOND // 20)
        return message

    with (
        node_on(domain_id, "player") as player,
        node_on(domain_id, "ear") as node,
        Talker(player.create_publisher(Clock, "/clock", 10), clock),
        Talker(player.create_publisher(PointCloud2, "/p", RELIABLE), lambda k: cloud(POINTS, 1000.0 + k / 20)),
    ):
        assert _sees(node, "/clock")
        heard = listen(node, "/p", 2.0)
    timed = [a for a in heard.arrivals if a.clock_ns is not None]
    assert timed
    assert all(1000 * SECOND <= a.clock_ns < 2000 * SECOND for a in timed)
    (age,) = check_age(heard.arrivals)
    assert "by simulated time (/clock)" in age.found


def _sees(node: Node, topic: str) -> bool:
    end = time.monotonic() + PATIENCE_S
    while not node.count_publishers(topic) and time.monotonic() < end:
        time.sleep(0.02)
    return node.count_publishers(topic) > 0


def test_livox_messages_are_heard_where_their_package_is_and_named_elsewhere(domain_id, monkeypatch):
    kind = install_livox_package(monkeypatch)
    times_ns = np.arange(len(POINTS)) * 1000
    with node_on(domain_id, "livox") as driver, node_on(domain_id, "ear") as node:
        publisher = driver.create_publisher(kind, "/livox/lidar", RELIABLE)
        with Talker(publisher, lambda k: fast_cdr(POINTS, times_ns, time.time_ns())):
            heard = listen(node, "/livox/lidar", 1.0)
            refused = run("doctor", "--live", "/livox/lidar", "--seconds", "1")
    assert heard.type == LIVOX_TYPE
    assert {(a.frame_id, a.num_points) for a in heard.arrivals} == {("livox_frame", len(POINTS))}
    assert names(heard)["point times"] == "ok"
    assert_refused(refused, "/livox/lidar: expected", f"found {LIVOX_TYPE} of /livox", NO_LIVOX_PACKAGE)


def test_where_no_node_is_seen_it_says_where_it_looked(domain_id):
    assert_refused(run("doctor", "--live", "/p", "--seconds", "1"), "no ROS node is seen", f"ROS_DOMAIN_ID {domain_id}")


@pytest.fixture
def driver(domain_id):
    with node_on(domain_id, "driver") as driver:
        driver.create_publisher(PointCloud2, "/lidar/points", RELIABLE)
        driver.create_publisher(String, "/chatter", RELIABLE)
        yield driver


def test_a_topic_that_nobody_publishes_is_refused_with_those_that_have_clouds(driver):
    nobody = run("doctor", "--live", "/points", "--seconds", "1")
    assert_refused(nobody, "/points: nobody publishes it; topics with clouds: /lidar/points")


def test_a_topic_of_another_type_is_refused_by_that_type(driver):
    other = run("doctor", "--live", "/chatter", "--seconds", "1")
    assert_refused(other, "/chatter: expected sensor_msgs/msg/PointCloud2, found std_msgs/msg/String of /driver")


def test_a_driver_that_sends_nothing_is_an_error(driver):
    silent = run("doctor", "--live", "/lidar/points", "--seconds", "1")
    assert (silent.exit_code, "/lidar/points clouds" in silent.stderr) == (2, True)


def test_a_name_that_no_topic_can_have_is_refused(domain_id):
    with pytest.raises(InputError, match="cannot listen to no topic: failed to resolve name"):
        live.listen("no topic", 1.0)
