"""Clouds that are unusual and right: layouts, stamps, frames and sizes, each through the running node."""

from __future__ import annotations

import array
import contextlib

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from mini_data import POSES, pose_between, scan_room
from rclpy.qos import QoSProfile
from ros_bench import SECOND, Host, NodeBench, StreamBench, cloud, matrix
from sensor_msgs.msg import PointCloud2, PointField
from yardstick import PATIENCE_S, Stopwatch

from svc_ros.core.se3 import pose_error
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.ros.bag_player import CloudPlayer
from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]
NAMES = ("x", "y", "z")


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def host():
    with contextlib.closing(Host(own_domain_id(90))) as host:
        yield host


def packed(rows: np.ndarray, kind: int, is_bigendian: bool = False, row_padding: int = 0) -> PointCloud2:
    """A cloud of structured rows (H, W); `kind` is the datatype of x, y, z."""
    data = b"".join(row.tobytes() + bytes(row_padding) for row in rows)
    height, width = rows.shape
    message = PointCloud2(
        height=height, width=width, is_bigendian=is_bigendian, is_dense=False, point_step=rows.dtype.itemsize,
        row_step=width * rows.dtype.itemsize + row_padding, data=array.array("B", data),
    )  # fmt: skip
    offsets = rows.dtype.fields
    message.fields = [PointField(name=n, offset=offsets[n][1], datatype=kind, count=1) for n in NAMES]
    return message


def rows_of(points: np.ndarray, number: str, step: int, height: int) -> np.ndarray:
    """Structured rows (height, W), `step` bytes a point; W * height points at most, the rest is left out."""
    width = len(points) // height
    size = np.dtype(number).itemsize
    rows = np.zeros(
        width * height,
        np.dtype({"names": NAMES, "formats": [number] * 3, "offsets": [4, 4 + size, 4 + 2 * size], "itemsize": step}),
    )
    for name, column in zip(NAMES, points[: width * height].T, strict=True):
        rows[name] = column
    return rows.reshape(height, width)


LAYOUTS = {
    "organised": (("<f4", 16, 16), PointField.FLOAT32, False, 0),
    "padded": (("<f4", 48, 4), PointField.FLOAT32, False, 20),
    "doubles": (("<f8", 32, 1), PointField.FLOAT64, False, 0),
    "big-endian": ((">f4", 22, 1), PointField.FLOAT32, True, 0),
    "big-endian-doubles": ((">f8", 28, 8), PointField.FLOAT64, True, 7),
}


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """A node in a namespace, whose inputs are remapped to the topics of a driver."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        with Robot(tmp_path_factory.mktemp("node")) as robot:
            yield robot


class Robot(NodeBench):
    name = "/robot/matcher"

    def __init__(self, folder) -> None:
        reliable = [f"qos_overrides./lidar/{side}.subscription.reliability:=reliable" for side in ("new", "old")]
        super().__init__(folder, own_domain_id(91), ["preset:=lidar_indoor", "process_every:=true", *reliable])
        self.process._command += [
            "-r", "__ns:=/robot", "-r", "__node:=matcher", "-r", "source_points:=/lidar/new",
            "-r", "target_points:=/lidar/old",
        ]  # fmt: skip
        self.player = CloudPlayer(self.node, self.executor, "/lidar/new", "/lidar/old")

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        return self.player.wait_for_subscribers(timeout_s)

    def decide(self, source: PointCloud2, target: PointCloud2, count: int = 1):
        """Publish one pair and return its decisions: of one stamp there may be several."""
        stamp_ns = ns_from_stamp(source.header.stamp)
        self.player.publish(source, target)
        found = spin_until(self.executor, lambda: len(self.decisions_on(stamp_ns)) >= count, PATIENCE_S)
        assert found, self.process.output()
        return self.decisions_on(stamp_ns)[-1]


def stamped(message: PointCloud2, stamp_ns: int, frame: str = "lidar") -> PointCloud2:
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
    return message


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_all_kinds_are_registered(pairs, name):
    (number, step, height), kind, is_bigendian, padding = LAYOUTS[name]
    stamp_ns = (10 + list(LAYOUTS).index(name)) * SECOND
    source, target = (
        stamped(packed(rows_of(points, number, step, height), kind, is_bigendian, padding), stamp_ns)
        for points in SCANS[1::-1]
    )
    decision = pairs.decide(source, target)
    assert (decision["verdict"], decision["reason"]) == ("accepted", "ok"), decision
    pairs.settle()
    assert pose_error(matrix(pairs.answers.transforms[-1]), pose_between(1, 0))[1] < 0.1


@pytest.mark.parametrize("frame", ["", "/lidar", 'a b\n"c"', "ü" * 60])
def test_frames_of_all_names_are_told_as_they_are(pairs, frame):
    stamp_ns = (20 + len(frame)) * SECOND
    source, target = (stamped(cloud(points, 1.0), stamp_ns, frame) for points in SCANS[1::-1])
    decision = pairs.decide(source, target)
    assert (decision["verdict"], decision["source_frame"], decision["target_frame"]) == ("accepted", frame, frame)
    pairs.settle()
    assert pairs.answers.transforms[-1].child_frame_id == frame


@pytest.mark.parametrize("stamp_ns", [2**31 * SECOND - 1, 0, -5 * SECOND + 10, -(2**31) * SECOND])
def test_stamps_at_the_ends_of_time_are_told_as_they_are(pairs, stamp_ns):
    before = len(pairs.answers.transforms)
    decision = pairs.decide(stamped(cloud(SCANS[1], 1.0), stamp_ns), stamped(cloud(SCANS[0], 1.0), stamp_ns))
    assert (decision["verdict"], decision["source_stamp"]) == ("accepted", text_from_ns(stamp_ns))
    pairs.settle()
    (transform,) = pairs.answers.transforms[before:]
    assert ns_from_stamp(transform.header.stamp) == stamp_ns


def test_pairs_with_the_same_stamp_have_a_decision_each(pairs):
    for count in (1, 2, 3):
        decision = pairs.decide(cloud(SCANS[1], 500.0), cloud(SCANS[0], 500.0), count)
        assert decision["verdict"] == "accepted"
    pairs.settle()
    assert len(pairs.decisions_on(500 * SECOND)) == 3


def test_clouds_of_one_point_and_of_300000_points(pairs):
    rng = np.random.default_rng(0)
    many = [np.repeat(points, 300_000 // len(points) + 1, axis=0)[:300_000] for points in SCANS[1::-1]]
    many = [points + rng.normal(0.0, 0.005, points.shape) for points in many]
    assert pairs.decide(cloud(SCANS[1][:1], 600.0), cloud(SCANS[0], 600.0))["reason"] == "too_few_points"
    decision = pairs.decide(cloud(many[0], 601.0), cloud(many[1], 601.0))
    assert decision["verdict"] == "accepted", decision


def test_a_stream_whose_stamps_never_move_is_dropped_and_goes_on_when_they_do(tmp_path):
    parameters = {"mode": "scan_matching", "preset": "lidar_indoor", "process_every": "true"}
    with StreamBench(tmp_path, own_domain_id(92), parameters) as bench:
        assert bench.decide(cloud(SCANS[0], 0.0))["origin"] == "start"
        again = bench.decide(cloud(SCANS[0], 0.0))
        assert (again["verdict"], again["reason"]) == ("dropped", "stale")
        assert bench.decide(cloud(SCANS[0], 0.1))["verdict"] == "accepted"
        # A stamp of the next century is the next stamp; from there the present is a jump back.
        assert bench.decide(cloud(SCANS[0], 2.0e9))["verdict"] == "accepted"
        assert bench.decide(cloud(SCANS[0], 0.2))["origin"] == "start"


@pytest.mark.parametrize(
    "mode", ["scan_matching", *(pytest.param(mode, marks=pytest.mark.slow) for mode in ("pair", "loop_closure"))]
)
def test_big_clouds_that_come_fast_leave_the_executor_alive(host, mode):
    """300,000 points ten times a second: callbacks take them in, and services answer meanwhile."""
    host.start(mode=mode, process_every=False)
    points = np.repeat(SCANS[0], 300_000 // len(SCANS[0]) + 1, axis=0)[:300_000]
    names = ["source_points", "target_points"] if mode == "pair" else ["points"]
    publishers = [host.node.create_publisher(PointCloud2, f"/{name}", QoSProfile(depth=2)) for name in names]
    assert spin_until(host.executor, lambda: all(p.get_subscription_count() for p in publishers), PATIENCE_S)
    answers = []
    for k in range(20):
        for publisher in publishers:
            publisher.publish(cloud(points, 1.0 + 0.1 * k))
        with Stopwatch() as watch:
            counts = host.status()
        answers.append(watch.own_s)
        assert counts["jobs"]["received"] == (
            counts["jobs"]["pending"] + counts["jobs"]["without_candidate"] + sum(counts["decisions"].values())
        )
        assert counts["worker"]["queue"] <= (8 if mode == "loop_closure" else 1)
    assert np.median(answers) < 1.0
    assert counts["received"][names[0].partition("_")[0]] >= 10
