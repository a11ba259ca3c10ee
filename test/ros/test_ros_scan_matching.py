"""Mode scan_matching over the real middleware, the node in a second process."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from mini_data import scan_room, sensor_pose
from rclpy.qos import QoSProfile
from ros_bench import SECOND, StreamBench, cloud, recorded_clouds
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger
from yardstick import PATIENCE_S, Stopwatch, assert_ends_within

from svc_ros.core.se3 import invert, make_pose, pose_error
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.trajectories import read_tum
from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

KITTI = "hdl64_kitti_a_10hz"
MAX_METRES, MAX_DEGREES = 0.3, 1.0


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def pose_of(message) -> np.ndarray:
    """(4, 4) of a geometry_msgs/Pose."""
    p, q = message.position, message.orientation
    return make_pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z))


def room(k: int, stamp_s: float, frame: str = "lidar"):
    """The room, seen from a place a step of 20 cm further for each k."""
    return cloud(scan_room(sensor_pose(0.2 * k, 0.1 * k, 2.0 * k), seed=k), stamp_s, frame)


def test_a_drive_at_10_hz_has_a_decision_for_each_scan_and_the_right_way(shared_data, tmp_path):
    clouds = recorded_clouds(shared_data / "bags" / KITTI)
    reference = read_tum(shared_data / "bags" / f"{KITTI}_reference_tum.txt")
    parameters = {"mode": "scan_matching", "process_every": "true"}
    with StreamBench(tmp_path, own_domain_id(10), parameters) as bench:
        with Stopwatch(bench.process.pid) as watch:
            bench.play(clouds, rate_hz=10.0)
            assert bench.collector.wait_for_decisions(len(clouds), PATIENCE_S), bench.process.output()
        assert spin_until(bench.executor, lambda: bench.paths and len(bench.paths[-1].poses) == len(clouds), PATIENCE_S)
        counts = bench.status()
    decisions = bench.answers.decisions
    computed_s = 1e-3 * sum(float(d["latency_ms"]) - float(d["queue_ms"]) for d in decisions)
    assert computed_s - watch.others_s < len(clouds) / 10.0, watch  # it keeps up
    assert [d["verdict"] for d in decisions] == ["accepted"] * len(clouds), decisions
    assert counts["jobs"] == {"received": len(clouds), "pending": 0, "without_candidate": 0}
    assert len(bench.odometry) == len(bench.answers.transforms) == len(bench.answers.poses) == len(clouds)
    assert bench.answers.rejected == [False] * len(clouds)
    stamps = [ns_from_stamp(m.header.stamp) for m in bench.odometry]
    truth = [reference.at(stamp, 10 * SECOND) for stamp in stamps]
    for message, T_world_sensor in zip(bench.odometry, truth, strict=True):
        rotation_deg, translation_m = pose_error(pose_of(message.pose.pose), invert(truth[0]) @ T_world_sensor)
        assert rotation_deg < MAX_DEGREES
        assert translation_m < MAX_METRES
        assert (np.linalg.eigvalsh(message.pose.covariance.reshape(6, 6)) > 0.0).all()
    assert {(m.header.frame_id, m.child_frame_id) for m in bench.odometry} == {("odom", "velodyne")}
    way = bench.paths[-1]
    assert [ns_from_stamp(p.header.stamp) for p in way.poses] == stamps
    assert way.poses[-1].pose == bench.odometry[-1].pose.pose
    # The velocity is that of the drive, in the sensor's own frame: forwards.
    step = invert(truth[-2]) @ truth[-1]
    seconds = (stamps[-1] - stamps[-2]) / SECOND
    linear = bench.odometry[-1].twist.twist.linear
    assert np.linalg.norm(np.array([linear.x, linear.y, linear.z]) - step[:3, 3] / seconds) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0, 5], ids=["whole", "carried-away"])
def test_a_walk_at_four_times_its_rate_stays_right(shared_data, tmp_path, missing):
    """`missing`: so many scans, a second apart, are never seen; from there on it is right or says nothing."""
    folder = shared_data / "bags" / "os0_64_walk"
    clouds, reference = recorded_clouds(folder / "ros2_mcap"), read_tum(folder / "reference_tum.txt")
    clouds = clouds[:40] + clouds[40 + missing :]
    with StreamBench(tmp_path, own_domain_id(14), {"mode": "scan_matching", "preset": "lidar_indoor"}) as bench:
        bench.play(clouds, rate_hz=4.0)
        assert bench.collector.wait_for_decisions(len(clouds), PATIENCE_S), bench.process.output()
        bench.settle()
    stamps = [ns_from_stamp(m.header.stamp) for m in bench.odometry]
    truth = [reference.at(stamp, SECOND) for stamp in stamps]
    errors = [
        pose_error(pose_of(m.pose.pose), invert(truth[0]) @ T) for m, T in zip(bench.odometry, truth, strict=True)
    ]
    assert np.sqrt(np.mean([metres**2 for _, metres in errors])) < 0.5
    assert max(errors)[0] < 3.0
    assert len(errors) > 0.8 * len(clouds)
    assert max(stamps) > ns_from_stamp(clouds[-3].header.stamp)  # it came back


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        parameters = {"mode": "scan_matching", "preset": "lidar_indoor", "process_every": "true"}
        with StreamBench(tmp_path_factory.mktemp("node"), own_domain_id(11), parameters) as bench:
            yield bench


def begin(bench, stamp_s):
    """A fresh odometry: the room from its first place."""
    assert bench.call(Trigger, "reset", Trigger.Request()).success
    decision = bench.decide(room(0, stamp_s))
    assert (decision["verdict"], decision["origin"]) == ("accepted", "start")


def test_each_step_is_judged_against_a_keyframe_and_told_as_a_pose(bench):
    begin(bench, 100.0)
    for k in (1, 2):
        decision = bench.decide(room(k, 100.0 + 0.1 * k))
        assert (decision["verdict"], decision["origin"], decision["target_stamp"]) == (
            "accepted", "motion", "100.000000000"
        )  # fmt: skip
    bench.settle()
    first = sensor_pose(0.0, 0.0, 0.0)
    rotation_deg, translation_m = pose_error(
        pose_of(bench.odometry[-1].pose.pose), invert(first) @ sensor_pose(0.4, 0.2, 4.0)
    )
    assert rotation_deg < 0.5
    assert translation_m < 0.05


def test_a_late_scan_is_dropped_as_stale_and_the_next_goes_on(bench):
    begin(bench, 110.0)
    bench.decide(room(1, 110.2))
    late = bench.decide(room(1, 110.1))
    assert (late["verdict"], late["reason"]) == ("dropped", "stale")
    assert bench.decide(room(2, 110.3))["verdict"] == "accepted"


def seconds_of(ways) -> list[int]:
    return [pose.header.stamp.sec for way in ways for pose in way.poses]


def test_a_bag_that_starts_again_begins_a_new_odometry(bench):
    begin(bench, 120.0)
    bench.decide(room(1, 120.1))
    decision = bench.decide(room(2, 20.0))
    assert (decision["verdict"], decision["origin"]) == ("accepted", "start")
    bench.settle()
    np.testing.assert_allclose(pose_of(bench.odometry[-1].pose.pose), np.eye(4), atol=1e-9)
    assert spin_until(bench.executor, lambda: seconds_of(bench.paths[-1:]) == [20], PATIENCE_S)


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        (cloud(np.full((100, 3), np.nan), 130.1), "too_few_points"),
        (cloud(np.ones((50, 3)), 130.1), "too_few_points"),
        (room(1, 130.1, "camera"), "unsupported_cloud"),
    ],
    ids=["nan", "few", "frame"],
)
def test_a_scan_that_cannot_be_used_says_why_and_the_next_goes_on(bench, broken, reason):
    begin(bench, 130.0)
    bench.settle()
    num_poses = len(bench.odometry)
    decision = bench.decide(broken)
    assert (decision["verdict"], decision["reason"]) == ("rejected", reason)
    assert bench.decide(room(2, 130.2))["verdict"] == "accepted"
    bench.settle()
    assert len(bench.odometry) == num_poses + 1


def test_half_a_message_is_refused_and_the_next_goes_on(bench):
    begin(bench, 135.0)
    half = room(1, 135.1)
    half.data = half.data[: len(half.data) // 2]
    assert bench.decide(half)["reason"] == "unsupported_cloud"
    assert bench.decide(room(1, 135.2))["verdict"] == "accepted"


def test_a_publisher_that_dies_is_replaced_by_the_next(bench):
    begin(bench, 140.0)
    bench.node.destroy_publisher(bench.points)
    bench.settle()
    bench.points = bench.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=100))
    assert bench.wait_for_subscribers(PATIENCE_S)
    decision = bench.decide(room(1, 140.5))
    assert (decision["verdict"], decision["target_stamp"]) == ("accepted", "140.000000000")


def test_a_disabled_node_drops_scans_as_inactive(bench):
    begin(bench, 150.0)
    assert bench.call(SetBool, "enable", SetBool.Request(data=False)).success
    assert bench.decide(room(1, 150.1))["reason"] == "inactive"
    assert bench.call(SetBool, "enable", SetBool.Request(data=True)).success
    assert bench.decide(room(1, 150.2))["target_stamp"] == "150.000000000"


def test_verify_judges_the_last_scan_again(bench):
    assert bench.call(Trigger, "reset", Trigger.Request()).success
    answer = bench.call(Trigger, "verify", Trigger.Request())
    assert not answer.success
    assert "none since" in answer.message
    begin(bench, 160.0)
    decision = bench.decide(room(1, 160.1))
    answer = bench.call(Trigger, "verify", Trigger.Request())
    assert answer.success
    result = json.loads(answer.message)
    assert (result["verdict"], result["source_stamp_ns"], result["origin"]) == ("accepted", 160_100_000_000, "motion")
    error = pose_error(np.array(result["T_target_source"]), np.array(json.loads(decision["T_target_source"])))
    assert error[1] < 0.01


def test_a_changed_value_begins_a_new_odometry_with_the_next_scan(bench):
    begin(bench, 170.0)
    bench.set_parameter("scan_matching.keyframe_distance_m", 0.1)
    first, second = bench.decide(room(1, 170.1)), bench.decide(room(2, 170.2))
    bench.set_parameter("scan_matching.keyframe_distance_m", 8.0)
    assert first["origin"] == "start"
    assert second["target_stamp"] == "170.100000000"


def test_what_a_scan_shows_is_drawn_in_the_odometry_frame(bench):
    aligned = []
    subscription = bench.node.create_subscription(PointCloud2, "/svc_registration/aligned", aligned.append, 10)
    bench.settle()
    begin(bench, 180.0)
    bench.decide(room(2, 180.1))
    assert spin_until(bench.executor, lambda: len(aligned) == 2, PATIENCE_S)
    bench.node.destroy_subscription(subscription)
    assert {message.header.frame_id for message in aligned} == {"odom"}
    first, second = (scan_from_cloud(message).scan.points for message in aligned)
    distances, _ = cKDTree(first).query(second)
    assert np.median(distances) < 0.15  # both of one room, though the sensor has moved by 0.45 m


def test_all_scans_have_one_decision_in_the_end(bench):
    bench.settle()
    counts, decisions = bench.status(), bench.answers.decisions
    assert counts["jobs"]["pending"] == 0
    assert counts["jobs"]["received"] == len(decisions) == sum(counts["decisions"].values())
    accepted = sum(d["verdict"] == "accepted" for d in decisions)
    assert accepted == len(bench.odometry) == len(bench.answers.transforms)


@pytest.mark.slow
def test_at_ten_times_the_rate_the_newest_win_and_the_counts_are_right_at_every_moment(tmp_path):
    parameters = {
        "mode": "scan_matching", "preset": "lidar_indoor", "queue_size": "2",
        "qos_overrides./points.subscription.depth": "200",  # what the middleware loses nobody can count
    }  # fmt: skip
    with StreamBench(tmp_path, own_domain_id(12), parameters) as bench:
        snapshots, pace = [], 150.0
        for part in range(6):
            bench.play([room(k % 3, 1.0 + 0.01 * (20 * part + k)) for k in range(20)], pace)
            snapshots.append(bench.status())
        num_played = 6 * 20
        assert bench.collector.wait_for_decisions(num_played, PATIENCE_S)
        bench.settle()
        last = bench.status()
    for counts in [*snapshots, last]:
        assert counts["jobs"]["received"] == counts["jobs"]["pending"] + sum(counts["decisions"].values())
        assert counts["received"]["points"] == counts["jobs"]["received"]
        assert counts["worker"]["queue"] <= 2
    assert last["jobs"] == {"received": num_played, "pending": 0, "without_candidate": 0}
    assert last["reasons"].get("superseded", 0) > 0
    assert len(bench.answers.decisions) == num_played
    assert len({d["source_stamp"] for d in bench.answers.decisions}) == num_played


@pytest.mark.slow
def test_ctrl_c_in_the_middle_of_a_scan_ends_the_node(shared_data, tmp_path):
    clouds = recorded_clouds(shared_data / "bags" / KITTI)[:6]
    with StreamBench(tmp_path, own_domain_id(13), {"mode": "scan_matching", "process_every": "true"}) as bench:
        bench.play(clouds, rate_hz=100.0)
        assert_ends_within(2.0, bench.process)
        assert "Traceback" not in bench.process.output()
