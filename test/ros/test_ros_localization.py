"""Mode localization over the real middleware: a drive through a room whose map is on disk; tf2 is a stand-in."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from assertions import assert_given_back

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from map_cases import CONFIG, write_room_map
from mini_data import scan_room, sensor_pose
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from ros_bench import SECOND, Host, cloud, matrix
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from stand_in_tf2 import tf2_module, transform_of
from std_srvs.srv import Trigger
from yardstick import PATIENCE_S

from svc_ros.core.errors import ConfigError, InputError
from svc_ros.core.se3 import invert, make_pose, pose_error
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.results import decision_values
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.pipeline.localisation import Localiser
from svc_ros.pipeline.map import Map
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import own_domain_id
from svc_ros.ros.topics import map_output
from svc_ros.ros.topics.conversions import header, plain_pose

pytestmark = pytest.mark.dds

WAY = [sensor_pose(-2.5 + 0.7 * k, 0.2 * k, 10.0 * k) for k in range(8)]
T_ODOM_MAP = make_pose(Rotation.from_euler("z", 40, degrees=True).as_matrix(), (3.0, -7.0, 0.0))
T_BASE_LIDAR = make_pose(np.eye(3), (0.2, 0.0, 1.2))
FAR = {"2 m": (2.0, 0.0, 0.0), "5 m": (-3.0, 4.0, 0.0), "10 m": (0.0, -10.0, 0.0)}


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps") / "room"
    write_room_map(folder)
    return str(folder)


@pytest.fixture
def host(monkeypatch, room):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(110))) as host:
        yield host
    assert_given_back(Path(room))


def start(host: Host, folder: str, **parameters):
    return host.start(mode="localization", preset="auto", map_folder=folder, **parameters)


def seen_from(k: int, rounds: int = 0, scale: float = 1.0) -> PointCloud2:
    """The scan of stand k of the way, a second from the next one; rounds: 16 s later; scale: of the room."""
    return cloud(scale * scan_room(WAY[k], seed=50 + k), 10.0 + k + 16.0 * rounds)


def elsewhere(k: int) -> PointCloud2:
    """A scan of a smaller room, so late that nothing is known any more of where the sensor could have gone."""
    return seen_from(k, 1, 0.6)


def shifted(T: np.ndarray, shift=(0.0, 0.0, 0.0), yaw_deg: float = 0.0) -> np.ndarray:
    return T @ make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), shift)


class Robot:
    """Tells odometry and sends scans; hears decisions, poses and diagnostics."""

    def __init__(self, host: Host, odometry: bool = True) -> None:
        self.host = host
        self._points = host.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=10))
        self._odometry = host.node.create_publisher(Odometry, "/odom", QoSProfile(depth=100)) if odometry else None
        self.initial = host.node.create_publisher(PoseWithCovarianceStamped, "/initialpose", QoSProfile(depth=10))
        self.collector = DecisionCollector(host.node, host.executor)
        self._health: list[DiagnosticArray] = []
        host.node.create_subscription(DiagnosticArray, "/diagnostics", self._health.append, 10)
        ends = [end for end in (self._points, self._odometry) if end is not None]
        assert spin_until(host.executor, lambda: all(end.get_subscription_count() for end in ends), PATIENCE_S)

    def see(self, message: PointCloud2, T_map_lidar: np.ndarray, num: int = 1) -> list[dict[str, str]]:
        """The decisions on a scan, of which there are `num`, its odometry told before."""
        if self._odometry is not None:
            told = Odometry(header=message.header, child_frame_id=message.header.frame_id)
            told.header = header(ns_from_stamp(message.header.stamp), "odom")
            told.pose.pose = plain_pose(T_ODOM_MAP @ T_map_lidar)
            self._odometry.publish(told)
        before = len(self.collector.answers.decisions)
        self._points.publish(message)
        assert self.collector.wait_for_decisions(before + num, PATIENCE_S)
        return self.collector.answers.decisions[before:]

    def tell(self, T_map_lidar: np.ndarray, stamp_s: float, frame: str = "map") -> None:
        """On initialpose; the node has it when this returns."""
        assert spin_until(self.host.executor, self.initial.get_subscription_count, PATIENCE_S)
        message = PoseWithCovarianceStamped(header=header(round(stamp_s * SECOND), frame))
        message.pose.pose = plain_pose(T_map_lidar)
        self.initial.publish(message)
        self.host.status()

    def health(self) -> DiagnosticStatus:
        """The next status of localization."""
        self._health.clear()
        assert spin_until(self.host.executor, lambda: bool(self._health), PATIENCE_S)
        (status,) = [s for s in self._health[-1].status if s.name == "svc_registration: localization"]
        return status

    @property
    def poses(self):
        spin_until(self.host.executor, lambda: False, 0.1)
        return self.collector.answers.poses


def place(message) -> np.ndarray:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return make_pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z))


def assert_near(T: np.ndarray, expected: np.ndarray) -> None:
    angle, distance = pose_error(T, expected)
    assert (angle, distance) < (1.0, 0.1)
    assert distance < 0.1


def test_a_drive_is_found_and_followed_as_the_library_does_it(host, room):
    start(host, room, odometry="topic")
    robot, messages = Robot(host), [seen_from(k) for k in range(4)]
    with Map.read(room) as known:
        localiser = Localiser(known, CONFIG)
        expectations = [
            localiser.add(scan_from_cloud(message).scan, T_ODOM_MAP @ T)
            for message, T in zip(messages, WAY, strict=False)
        ]
    for k, (expected,) in enumerate(expectations):
        (told,) = robot.see(messages[k], WAY[k])
        assert told["origin"] == expected.origin == ("motion" if k else "place")
        values = decision_values(expected.result, expected.source_stamp_ns, expected.target_stamp_ns)
        assert {name: told[name] for name in values if "_ms" not in name} == (
            {name: value for name, value in values.items() if "_ms" not in name}
        )
    assert len(robot.poses) == 4
    for T, message in zip(WAY, robot.poses, strict=False):
        assert message.header.frame_id == "map"
        assert_near(place(message), T)
        variances = np.linalg.eigvalsh(np.array(message.pose.covariance).reshape(6, 6))
        assert variances[0] > 0.0
        assert variances[-1] < 0.1**2
    status = host.status()
    assert (status["preset"], status["worker"]["state"], status["worker"]["map_keyframes"]) == ("map", "localised", 5)
    health = robot.health()
    assert (health.level, health.message) == (DiagnosticStatus.OK, "localised")


def test_told_poses_are_judged_and_a_place_elsewhere_is_lost_and_found(host, room):
    start(host, room, odometry="topic", process_every=False)
    robot = Robot(host)
    assert robot.health().level == DiagnosticStatus.WARN  # searching
    robot.see(seen_from(0), WAY[0])

    robot.tell(WAY[1], 11.0)
    told, own = robot.see(seen_from(1), WAY[1], 2)
    assert (told["origin"], told["verdict"], own["verdict"]) == ("told", "accepted", "accepted")
    assert not host.status()["worker"]["told_wrong"]

    wrong = [shifted(WAY[2], shift) for shift in FAR.values()] + [shifted(WAY[2], yaw_deg=20.0)]
    for k, T in enumerate(wrong, 2):
        robot.tell(T @ invert(WAY[2]) @ WAY[k], 10.0 + k)
        told, own = robot.see(seen_from(k), WAY[k], 2)
        assert (told["origin"], told["verdict"], own["verdict"]) == ("told", "rejected", "accepted")
        assert host.status()["worker"]["told_wrong"]
    health = robot.health()
    assert (health.level, health.message) == (DiagnosticStatus.ERROR, "localised; the pose that others tell is wrong")
    assert len(robot.poses) == 6  # a told pose is none of the node's own

    (lost,) = robot.see(elsewhere(6), WAY[6])
    assert lost["verdict"] != "accepted"
    assert host.status()["worker"]["state"] == "lost"
    health = robot.health()
    assert health.level == DiagnosticStatus.ERROR
    (found,) = robot.see(seen_from(7, 1), WAY[7])
    assert found["verdict"] == "accepted"
    assert_near(place(robot.poses[-1]), WAY[7])
    assert host.status()["worker"]["state"] == "localised"
    assert json.loads(host.call(Trigger, "/svc_registration/verify", Trigger.Request()).message)["verdict"] == (
        "accepted"
    )


def test_a_pose_told_between_two_scans_goes_on_with_odometry(host, room):
    start(host, room, odometry="topic")
    robot = Robot(host)
    robot.see(seen_from(0), WAY[0])
    robot.tell(WAY[0], 10.0)
    told, _ = robot.see(seen_from(1), WAY[1], 2)  # 0.7 m further
    assert (told["origin"], told["verdict"]) == ("told", "accepted")
    robot.tell(WAY[1], 9.0)  # before all odometry
    (own,) = robot.see(seen_from(2), WAY[2])
    assert own["origin"] == "motion"
    assert "expected odometry at 9.000000000 s" in host.status()["worker"]["told_problem"]
    robot.tell(WAY[3], 5000.0)  # another clock
    (own,) = robot.see(seen_from(3), WAY[3])
    assert own["origin"] == "motion"
    robot.tell(shifted(WAY[4], (2.0, 0.0, 0.0)), 0.0)  # no stamp: now
    told, _ = robot.see(seen_from(4), WAY[4], 2)
    assert told["verdict"] == "rejected"


class Tree:
    """What tf2 knows: odometry of the base, the lidar on it, and where another localisation says that it is."""

    def __init__(self) -> None:
        self.error = np.eye(4)  # of what others say
        self.has_odometry = True
        self.newest_ns = 10**12  # of what others say

    def module(self) -> ModuleType:
        return tf2_module(self.look_up)

    def look_up(self, target: str, source: str, wanted_ns: int):
        stamp_ns = wanted_ns or self.newest_ns
        k = (stamp_ns // SECOND - 10) % 16
        if (target, source) == ("base_link", "lidar"):
            return transform_of(T_BASE_LIDAR)
        if (target, source) == ("odom", "lidar") and self.has_odometry:
            return transform_of(T_ODOM_MAP @ WAY[k])
        if (target, source) == ("map", "lidar") and self.error is not None and stamp_ns <= self.newest_ns:
            return transform_of(self.error @ WAY[k], stamp_ns)
        raise LookupError("not in the tree")


class TfTopic:
    """Takes the place of /tf: keeps what is sent."""

    sent: list = []  # noqa: RUF012

    def __init__(self, _node, wanted_by):
        assert wanted_by == "publish_tf"

    def publish(self, message, _child_frame):
        self.sent.append(message)

    def destroy(self): ...


@pytest.fixture
def tree(monkeypatch):
    tree = Tree()
    monkeypatch.setitem(sys.modules, "tf2_ros", tree.module())
    monkeypatch.setattr(map_output, "TransformOutput", TfTopic)
    monkeypatch.setattr(TfTopic, "sent", [])
    return tree


def is_silent(host: Host) -> bool:
    """But for one that may be on its way, nothing is sent in ten periods."""
    before = len(TfTopic.sent)
    return not spin_until(host.executor, lambda: len(TfTopic.sent) > before + 1, 0.5)


def test_odometry_in_the_map_is_on_tf_while_the_place_is_known_and_the_pose_is_the_bases(host, tree, room):
    start(host, room, odometry="tf", publish_tf=True, base_frame="base_link")
    robot = Robot(host, odometry=False)
    assert TfTopic.sent == []
    robot.see(seen_from(0), WAY[0])
    assert spin_until(host.executor, lambda: len(TfTopic.sent) >= 2, PATIENCE_S)
    message = TfTopic.sent[-1]
    assert (message.header.frame_id, message.child_frame_id) == ("map", "odom")
    assert_near(matrix(message), invert(T_ODOM_MAP))
    assert_near(place(robot.poses[-1]), WAY[0] @ invert(T_BASE_LIDAR))
    robot.see(elsewhere(1), WAY[1])
    assert is_silent(host)
    robot.see(seen_from(2, 1), WAY[2])
    assert not is_silent(host)
    tree.has_odometry = False
    (decision,) = robot.see(seen_from(3, 2), WAY[3])  # 17 s later: nothing has confirmed its place since
    assert (decision["verdict"], decision["reason"]) == ("rejected", "tf_unavailable")
    assert host.status()["worker"]["state"] == "lost"
    assert is_silent(host)
    tree.has_odometry = True
    robot.see(seen_from(4, 2), WAY[4])
    assert not is_silent(host)
    assert host.call(Trigger, "/svc_registration/reset", Trigger.Request()).success
    assert host.status()["worker"]["state"] == "searching"
    assert is_silent(host)


def test_who_is_lost_on_tf_is_told_so_and_once_where_he_is(host, tree, room):
    start(host, room, odometry="tf", told_by="tf", publish_initialpose=True)
    robot, told = Robot(host, odometry=False), []
    host.node.create_subscription(PoseWithCovarianceStamped, "/initialpose", told.append, 10)
    ends = robot.initial.get_subscription_count  # the test's own
    assert spin_until(host.executor, lambda: ends() == 1, PATIENCE_S)
    verdicts = []
    for k in range(2):
        verdicts += [d["verdict"] for d in robot.see(seen_from(k), WAY[k], 2)]
    assert verdicts == ["accepted"] * 4
    assert robot.health().level == DiagnosticStatus.OK
    tree.error = make_pose(np.eye(3), (1.5, -1.5, 0.0))
    for k in range(2, 7):
        verdicts = [d["verdict"] for d in robot.see(seen_from(k), WAY[k], 2)]
        assert verdicts == ["rejected", "accepted"]
    assert robot.health().level == DiagnosticStatus.ERROR
    spin_until(host.executor, lambda: bool(told), PATIENCE_S)
    (message,) = told
    assert ns_from_stamp(message.header.stamp) == 14 * SECOND  # the third of those
    assert_near(place(message), WAY[4])
    tree.error = None  # gone
    (own,) = robot.see(seen_from(7), WAY[7])
    assert own["verdict"] == "accepted"
    assert "not in the tree" in host.status()["worker"]["told_problem"]


def test_who_tells_late_is_judged_once_for_each_pose(host, tree, room):
    start(host, room, odometry="tf", told_by="tf", tf_timeout=0.0)
    robot = Robot(host, odometry=False)
    robot.see(seen_from(0), WAY[0], 2)
    tree.newest_ns = 11 * SECOND
    robot.see(seen_from(1), WAY[1], 2)
    (own,) = robot.see(seen_from(2), WAY[2])  # what is newest was judged
    assert own["origin"] == "motion"
    tree.newest_ns = 12 * SECOND
    told, _ = robot.see(seen_from(3), WAY[3], 2)  # 0.7 m further than what is newest
    assert (told["origin"], told["verdict"]) == ("told", "accepted")
    tree.newest_ns, tree.error = 13 * SECOND, make_pose(np.eye(3), (2.0, 0.0, 0.0))
    told, _ = robot.see(seen_from(4), WAY[4], 2)
    assert told["verdict"] == "rejected"
    robot.see(seen_from(5, 1), WAY[5])  # 17 s later: nobody tells any more
    assert "at 31.000000000 s" in host.status()["worker"]["told_problem"]


def test_the_node_is_configured_again_and_looks_anew(host, room):
    start(host, room, odometry="topic")
    robot = Robot(host)
    robot.see(seen_from(0), WAY[0])
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
        assert host.change(transition)
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        assert host.change(transition)
    assert host.status()["worker"]["state"] == "searching"
    robot = Robot(host)
    (decision,) = robot.see(seen_from(1), WAY[1])
    assert (decision["verdict"], decision["origin"]) == ("accepted", "place")


def test_a_map_that_is_none_and_a_value_that_it_was_not_made_with_are_refused(host, room, tmp_path):
    with pytest.raises(InputError, match="gone: expected the folder of a map, found none"):
        start(host, str(tmp_path / "gone"))
    with pytest.raises(ConfigError, match=r"features\.max_neighbours: expected 400"):
        start(host, room, **{"features.max_neighbours": 99})
    node = start(host, room)
    refused = node.set_parameters_atomically([Parameter("preprocess.voxel_size_m", value=0.5)])
    assert not refused.successful
    assert refused.reason == "preprocess.voxel_size_m: the map was made with another value"
    assert node.get_parameter("preprocess.min_range_m").value == CONFIG.preprocess.min_range_m
