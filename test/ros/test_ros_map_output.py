"""Where odometry stands in a map, through the running node; tf2 is a stand-in with a moving robot and known places."""

from __future__ import annotations

import contextlib
import itertools
import subprocess
import sys
import threading
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticStatus
from mini_data import POSES, pose_between, scan_room, write_bin
from pages import PAGES, blocks
from rclpy.qos import QoSProfile
from ros_bench import Host, cloud, matrix
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from stand_in_tf2 import tf2_module, transform_of
from std_srvs.srv import SetBool, Trigger
from yardstick import PATIENCE_S

from svc_ros.core.errors import ConfigError, TransformUnavailableError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import invert, make_pose, pose_error
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.diagnostics import Statistics, statuses
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.processes import local_environment, own_domain_id
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics import map_output

pytestmark = pytest.mark.dds

SECOND = 1_000_000_000
SETTINGS = NodeSettings(map_frame="map", transform_tolerance=0.3)
T_MAP_PLACE = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (20.0, -4.0, 0.0))


def odometry(stamp_ns: int) -> np.ndarray:
    """T_odom_lidar (4, 4): the robot drives along x of its odometry."""
    return make_pose(np.eye(3), (1.5 * stamp_ns / SECOND, 0.0, 0.0))


class Tree:
    """What tf2 knows: `place` stands still in `map`, `lidar` moves in `odom`, and `rear_lidar` with it."""

    def __init__(self) -> None:
        self.has_odometry = True

    def module(self) -> ModuleType:
        return tf2_module(self.look_up)

    def look_up(self, target: str, source: str, stamp_ns: int):
        if (target, source) == ("map", "place"):
            return transform_of(T_MAP_PLACE)
        if (target, source) == ("map", "rear_lidar") and stamp_ns >= SECOND:
            return transform_of(odometry(stamp_ns))  # by way of odometry, so not for all time
        if (target, source) == ("odom", "lidar") and self.has_odometry and stamp_ns >= SECOND:
            return transform_of(odometry(stamp_ns))
        raise LookupError("not in the tree")


class TfTopic:
    """Takes the place of /tf: keeps what is sent, with the clock of the node."""

    def __init__(self, node, wanted_by):
        assert wanted_by == "map_frame"
        self.node = node

    sent: list = []  # noqa: RUF012

    def publish(self, message, _child_frame):
        self.sent.append((message, self.node.get_clock().now().nanoseconds))

    def destroy(self): ...


@pytest.fixture
def tree(monkeypatch):
    tree = Tree()
    monkeypatch.setitem(sys.modules, "tf2_ros", tree.module())
    monkeypatch.setattr(map_output, "TransformOutput", TfTopic)
    monkeypatch.setattr(TfTopic, "sent", [])
    return tree


@pytest.fixture
def host(monkeypatch, tree):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(97))) as host:
        yield host


class Robot:
    """Sends the scan of a known place with each live one, and hears the answer."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._ends = [host.node.create_publisher(PointCloud2, f"/{side}_points", QoSProfile(depth=10))
                      for side in ("source", "target")]  # fmt: skip
        self._collector = DecisionCollector(host.node, host.executor)
        assert spin_until(host.executor, lambda: all(e.get_subscription_count() for e in self._ends), PATIENCE_S)

    def see(self, stamp_s: float, points: np.ndarray, frame: str = "lidar", place: str = "place") -> dict[str, str]:
        before = len(self._collector.answers.decisions)
        for end, seen, name in zip(self._ends, (points, scan_room(POSES[0])), (frame, place), strict=True):
            end.publish(cloud(seen, stamp_s, name))
        assert self._collector.wait_for_decisions(before + 1, PATIENCE_S)
        return self._collector.answers.decisions[-1]

    def hears_more(self) -> bool:
        """Wait for two more transforms."""
        before = len(TfTopic.sent)
        return spin_until(self._host.executor, lambda: len(TfTopic.sent) >= before + 2, PATIENCE_S)


def told() -> np.ndarray:
    """T_map_odom as it was sent last."""
    return matrix(TfTopic.sent[-1][0])


def assert_near(T: np.ndarray, expected: np.ndarray) -> None:
    angle, distance = pose_error(T, expected)
    assert (angle, distance) < (1.0, 0.1)


def test_an_accepted_pair_tells_where_odometry_stands_in_the_map_and_nothing_else_does(host, tree):
    host.start(map_frame="map", transform_tolerance=0.3)
    robot = Robot(host)
    nothing = np.random.default_rng(0).normal(size=(4000, 3)) * 8.0
    assert robot.see(1.0, nothing)["verdict"] != "accepted"
    assert host.status()["output"]["map_updates"] == 0
    assert TfTopic.sent == []

    assert robot.see(4.0, scan_room(POSES[1], seed=1))["verdict"] == "accepted"
    assert robot.hears_more()
    expected = T_MAP_PLACE @ pose_between(1, 0) @ invert(odometry(4 * SECOND))
    assert_near(told(), expected)
    for message, now_ns in TfTopic.sent:
        assert (message.header.frame_id, message.child_frame_id) == ("map", "odom")
        assert 0 <= now_ns + 0.3 * SECOND - ns_from_stamp(message.header.stamp) < PATIENCE_S * SECOND
    stamps = [ns_from_stamp(message.header.stamp) for message, _ in TfTopic.sent]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))

    before = told()
    assert robot.see(5.0, nothing)["verdict"] != "accepted"
    assert robot.hears_more()
    np.testing.assert_array_equal(told(), before)

    assert robot.see(6.0, scan_room(POSES[2], seed=2))["verdict"] == "accepted"
    assert robot.hears_more()
    assert_near(told(), T_MAP_PLACE @ pose_between(2, 0) @ invert(odometry(6 * SECOND)))

    assert robot.see(7.0, scan_room(POSES[1], seed=1), place="rear_lidar")["verdict"] == "accepted"
    output = host.status()["output"]
    assert output["map_updates"] == 2
    assert output["map_problem"].startswith("expected a static transform from 'rear_lidar' to 'map': not in the tree")


def test_an_accepted_pair_without_odometry_changes_nothing_and_says_so(host, tree):
    host.start(map_frame="map")
    robot = Robot(host)
    tree.has_odometry = False
    assert robot.see(4.0, scan_room(POSES[1], seed=1))["verdict"] == "accepted"
    output = host.status()["output"]
    assert output["map_updates"] == 0
    assert output["map_problem"].startswith("expected a transform from 'lidar' to 'odom' at 4.000000000 s")
    assert TfTopic.sent == []
    tree.has_odometry = True
    assert robot.see(5.0, scan_room(POSES[1], seed=1))["verdict"] == "accepted"
    assert host.status()["output"]["map_problem"] == ""
    assert robot.hears_more()


def test_a_reset_forgets_and_an_inactive_node_is_silent(host, tree):
    node = host.start(map_frame="map")
    robot = Robot(host)
    assert robot.see(4.0, scan_room(POSES[1], seed=1))["verdict"] == "accepted"
    assert robot.hears_more()
    assert host.call(SetBool, "/svc_registration/enable", SetBool.Request(data=False)).success
    assert robot.hears_more()  # no new work, but where the robot is remains known
    assert host.call(SetBool, "/svc_registration/enable", SetBool.Request(data=True)).success
    node.trigger_deactivate()
    assert is_silent(host)
    node.trigger_activate()
    assert robot.hears_more()
    assert host.call(Trigger, "/svc_registration/reset", Trigger.Request()).success
    assert is_silent(host)


def is_silent(host: Host) -> bool:
    """But for one that may be on its way, nothing is sent in ten periods."""
    before = len(TfTopic.sent)
    return not spin_until(host.executor, lambda: len(TfTopic.sent) > before + 1, 0.5)


def test_the_program_of_the_page_sends_a_known_place_with_a_live_scan(host, tmp_path):
    (program,) = [text for text in blocks(PAGES["docs/integration.md"], "python") if "known_place" in text]
    (tmp_path / "known_place.py").write_text(program)
    write_bin(tmp_path / "place.bin", scan_room(POSES[0]))
    heard = {"source": [], "target": []}
    for side, clouds in heard.items():
        host.node.create_subscription(PointCloud2, f"/{side}_points", clouds.append, 10)
    live = host.node.create_publisher(PointCloud2, "/lidar/points", QoSProfile(depth=10))
    words = [sys.executable, "known_place.py", "place.bin", "--ros-args", "-r", "points:=/lidar/points"]
    with subprocess.Popen(words, cwd=tmp_path, env=local_environment(host.domain_id)) as running:
        try:
            assert spin_until(host.executor, live.get_subscription_count, PATIENCE_S)
            for stamp_s in range(10, 10 + 2 * round(PATIENCE_S)):  # best effort, and its ends may know each other later
                live.publish(cloud(np.ones((5, 3)), float(stamp_s), "lidar"))
                if spin_until(host.executor, lambda: all(heard.values()), 0.5):
                    break
        finally:
            running.kill()
    source, target = heard["source"][-1], heard["target"][-1]
    assert (source.header.frame_id, target.header.frame_id) == ("lidar", "place")
    assert (source.width, target.width) == (5, len(scan_room(POSES[0])))
    assert {ns_from_stamp(c.header.stamp) for c in heard["source"]} & {
        ns_from_stamp(c.header.stamp) for c in heard["target"]
    }


class Bench:
    """A MapOutput with a clock that is set by hand, and frames that are known."""

    def __init__(self, monkeypatch, known=None):
        self.now_ns, self.warnings, sent = 100 * SECOND, [], []
        known = {("map", "place"): T_MAP_PLACE, ("odom", "lidar"): odometry(SECOND)} if known is None else known

        class Tf:
            def __init__(self, *_given): ...
            def publish(self, message, _child):
                sent.append(message)

        def pose(target, source, *_when):
            if (target, source) not in known:
                raise TransformUnavailableError(f"{source} to {target}")
            return known[target, source]

        monkeypatch.setattr(map_output, "TransformOutput", Tf)
        monkeypatch.setattr(threading.Thread, "start", lambda _thread: None)
        clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))
        logger = SimpleNamespace(info=lambda _text: None, warning=self.warnings.append)
        node = SimpleNamespace(get_clock=lambda: clock, get_logger=lambda: logger)
        frames = SimpleNamespace(pose=pose, fixed_pose=pose)
        self.sent, self.output = sent, map_output.MapOutput(node, SETTINGS, frames, lambda: True)

    def accept(self, source="lidar", target="place"):
        result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", np.eye(4), np.eye(4))
        self.output.update(Decision(result, CloudLabel(SECOND, source), CloudLabel(SECOND, target)), SETTINGS)


def test_a_clock_that_stands_still_sends_nothing_twice_and_one_that_goes_back_forgets(monkeypatch):
    bench = Bench(monkeypatch)
    bench.accept()
    for step_ns, count in ((0, 1), (0, 1), (SECOND, 2), (-SECOND // 2, 3), (-2 * SECOND, 3), (9 * SECOND, 3)):
        bench.now_ns += step_ns
        bench.output._send()
        assert len(bench.sent) == count
    bench.accept()
    bench.output._send()
    assert len(bench.sent) == 4


@pytest.mark.parametrize(("source", "target"), [("lidar", "lidar"), ("map", "place"), ("lidar", "rear_lidar")])
def test_a_target_that_is_no_known_place_tells_nothing(monkeypatch, source, target):
    bench = Bench(monkeypatch)
    bench.accept(source, target)
    bench.output._send()
    assert bench.sent == []
    (warning,) = bench.warnings
    assert target in warning
    assert bench.output.numbers() == {"map_updates": 0, "map_problem": warning.partition("not used: ")[2]}


def test_a_pair_that_could_not_be_used_is_a_warning():
    flow = {"pairing": {}, "worker": {"ready": True, "enabled": True, "queue": 0, "queue_size": 1}}
    for problem, level in (("no odometry", DiagnosticStatus.WARN), ("", DiagnosticStatus.OK)):
        flow["output"] = {"reader_stopped": False, "map_updates": 1, "map_problem": problem}
        decisions = statuses(Statistics({}), flow, False)[-1]
        assert decisions.level == level
        assert problem in decisions.message


@pytest.mark.parametrize(
    ("wanted", "named"),
    [
        ({"mode": "scan_matching"}, "map_frame belongs to mode pair"),
        ({"mode": "loop_closure"}, "map_frame belongs to mode pair"),
        ({"publish_tf": True}, "map_frame and publish_tf exclude each other"),
        ({"odom_frame": "map"}, "map_frame and odom_frame have to differ"),
        ({"sensor_frame": "lidar"}, "map_frame and sensor_frame exclude each other"),
    ],
)
def test_what_does_not_go_with_a_map_frame_is_refused_by_name(wanted, named):
    with pytest.raises(ConfigError, match=named):
        NodeSettings(**{"map_frame": "map", **wanted})
