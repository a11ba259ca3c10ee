"""Mode loop_closure over the real middleware, the node in a second process: right loops only, and their graph."""

from __future__ import annotations

import json
import os
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from geometry_msgs.msg import PoseWithCovarianceStamped
from mini_data import POSES, pose_between, scan_room, sensor_pose
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_bench import SECOND, StreamBench, cloud, recorded_clouds
from std_srvs.srv import Trigger
from yardstick import PATIENCE_S, Stopwatch, assert_ends_within

from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import invert, pose_error
from svc_ros.io.datasets import read_dataset
from svc_ros.io.g2o import read_g2o
from svc_ros.io.stamps import ns_from_stamp, ns_from_text
from svc_ros.io.trajectories import read_tum
from svc_ros.ros.bag_player import CloudPlayer
from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import own_domain_id
from svc_ros.ros.topics.conversions import header, plain_pose, pose_message

pytestmark = pytest.mark.dds

MAX_DEGREES, MAX_METRES = 5.0, 0.6
WAY = [0.0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0]  # out and back through the room
ROOM_PARAMETERS = {
    "mode": "loop_closure", "preset": "lidar_indoor", "process_every": "true",
    "loop_closure.min_gap_s": "0.35", "loop_closure.keyframe_distance_m": "0.2",
}  # fmt: skip


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def wait_until_all_is_decided(bench, num_scans, timeout_s):
    counts = {}

    def is_done():
        counts.update(bench.status())
        return counts["jobs"]["received"] >= num_scans and counts["jobs"]["pending"] == 0

    assert spin_until(bench.executor, is_done, timeout_s), bench.process.output()
    bench.settle()
    return bench.status()


def candidate(decision) -> np.ndarray:
    return np.array(json.loads(decision["T_target_source"] or "null"))


def assert_right(decision, reference) -> None:
    source, target = (reference.at(ns_from_text(decision[f"{side}_stamp"]), SECOND) for side in ("source", "target"))
    rotation_deg, translation_m = pose_error(candidate(decision), invert(target) @ source)
    assert rotation_deg < MAX_DEGREES
    assert translation_m < MAX_METRES


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        pytest.param((slice(3, 13, 2), slice(57, 67, 2)), 3, id="two-visits"),
        pytest.param((slice(None),), 20, id="whole", marks=pytest.mark.slow),
    ],
)
def test_a_walk_back_to_earlier_places_has_right_loops_only(shared_data, tmp_path, parts, wanted):
    folder = shared_data / "bags" / "os0_64_walk"
    reference, drifting = read_tum(folder / "reference_tum.txt"), read_tum(folder / "odometry_tum.txt")
    clouds = recorded_clouds(folder / "ros2_mcap")
    clouds = [cloud for part in parts for cloud in clouds[part]]
    graph_file = tmp_path / "loops.g2o"
    parameters = {
        "mode": "loop_closure", "preset": "lidar_indoor", "process_every": "true", "odometry": "topic",
        "graph_file": str(graph_file),
    }  # fmt: skip
    with StreamBench(tmp_path, own_domain_id(20), parameters) as bench:
        odometry = bench.node.create_publisher(Odometry, "/odom", 100)
        assert spin_until(bench.executor, odometry.get_subscription_count, PATIENCE_S)
        for message in clouds:
            stamp_ns = ns_from_stamp(message.header.stamp)
            for offset_ns in (-SECOND // 4, SECOND // 4):  # the pose is interpolated
                told = Odometry(header=header(stamp_ns + offset_ns, "odom"), child_frame_id=message.header.frame_id)
                told.pose.pose = plain_pose(drifting.at(stamp_ns + offset_ns, SECOND))
                odometry.publish(told)
            bench.play([message], 10.0)
        counts = wait_until_all_is_decided(bench, len(clouds), 90.0)
        assert bench.process.stop() == 0
    accepted = [d for d in bench.answers.decisions if d["verdict"] == "accepted"]
    assert len(accepted) >= wanted, bench.answers.decisions
    for decision in accepted:
        assert_right(decision, reference)
        assert float(decision["source_stamp"]) - float(decision["target_stamp"]) > 20.0
    assert counts["worker"]["loops"] == len(accepted)
    assert sum(counts["decisions"].values()) == len(bench.answers.decisions)
    graph = read_g2o(graph_file)
    assert len(graph.poses) == counts["worker"]["keyframes"]
    assert len(graph.edges) == len(graph.poses) - 1 + len(accepted)


class OwnTime:
    """Time of the node [s] without what other programs had of the processors meanwhile; it is what a bag is played by.

    On a machine that does nothing else it is that of a clock.
    """

    def __init__(self, watch) -> None:
        self._watch, self._start = watch, time.monotonic()
        self._clock_s, self._own_s = [0.0], [0.0]

    def now_s(self) -> float:
        self._watch.look()
        elapsed = time.monotonic() - self._start
        self._clock_s.append(elapsed)
        self._own_s.append(max(elapsed - self._watch.others_so_far_s, self._own_s[-1]))
        return self._own_s[-1]

    def between(self, since: float, until: float) -> float:
        """Own seconds between two times of the steady clock."""
        before, after = np.interp([since - self._start, until - self._start], self._clock_s, self._own_s)
        return float(after - before)


def play_by_own_time(bench, clouds, rate_hz):
    """When each stamp was published (steady clock), and the node's own time."""
    published_s = {}
    with Stopwatch(bench.process.pid) as watch:
        own = OwnTime(watch)
        for number, message in enumerate(clouds):
            assert spin_until(bench.executor, lambda due=number / rate_hz: own.now_s() >= due, PATIENCE_S)
            published_s[ns_from_stamp(message.header.stamp)] = time.monotonic()
            bench.points.publish(message)
        counts = {}

        def is_done():
            own.now_s()
            counts.update(bench.status())
            return counts["jobs"]["received"] == len(clouds) and counts["jobs"]["pending"] == 0

        assert spin_until(bench.executor, is_done, PATIENCE_S), bench.process.output()
        own.now_s()
    print(f"played in {watch}, load {os.getloadavg()[0]:.1f}")
    return published_s, own


@pytest.mark.slow
def test_a_walk_at_four_times_its_rate_is_followed_scan_by_scan_while_loops_are_judged(shared_data, tmp_path):
    folder = shared_data / "bags" / "os0_64_walk"
    reference, clouds = read_tum(folder / "reference_tum.txt"), recorded_clouds(folder / "ros2_mcap")
    graph_file = tmp_path / "loops.g2o"
    parameters = {"mode": "loop_closure", "preset": "lidar_indoor", "graph_file": str(graph_file)}
    with StreamBench(tmp_path, own_domain_id(24), parameters) as bench:
        published_s, own = play_by_own_time(bench, clouds, 4.0)
        bench.settle()
        counts, decisions = bench.status(), bench.answers.decisions
        assert bench.process.stop() == 0
    # No scan is lost: all were followed, and of none has a candidate been given up.
    num_judged = len({d["source_stamp"] for d in decisions})
    assert counts["jobs"] == {"received": len(clouds), "pending": 0, "without_candidate": len(clouds) - num_judged}
    assert counts["decisions"]["dropped"] == 0
    last_words = {(d["source_stamp"], d["target_stamp"]): d for d in decisions}
    accepted = [d for d in last_words.values() if d["verdict"] == "accepted"]
    assert len(accepted) >= 25
    for decision in decisions:
        if decision["verdict"] == "accepted":
            assert_right(decision, reference)
    assert len(read_g2o(graph_file).edges) == counts["worker"]["keyframes"] - 1 + len(accepted)
    latencies_s = []
    for decision in (d for d in decisions if d["origin"] != "agreement"):
        begin = published_s[ns_from_text(decision["source_stamp"])]
        latencies_s.append(own.between(begin, begin + 1e-3 * float(decision["latency_ms"])))
    print(f"latency p95 {counts['latency_ms']['p95']:.0f} ms, own {1e3 * np.percentile(latencies_s, 95):.0f} ms")
    assert np.percentile(latencies_s, 95) < 1.5


def test_a_cloud_without_odometry_says_so(tmp_path):
    with StreamBench(tmp_path, own_domain_id(21), {**ROOM_PARAMETERS, "odometry": "topic"}) as bench:
        decision = bench.decide(cloud(scan_room(POSES[0]), 5.0))
    assert (decision["verdict"], decision["reason"]) == ("rejected", "tf_unavailable")
    assert "expected odometry at 5.000000000 s, found none so far" in decision["detail"]


def test_ctrl_c_in_the_middle_of_a_loop_ends_the_node_and_writes_the_graph_so_far(shared_data, tmp_path):
    clouds = recorded_clouds(shared_data / "bags" / "hdl64_kitti_a_10hz")[::3]
    parameters = {
        "mode": "loop_closure", "process_every": "true", "graph_file": str(tmp_path / "loops.g2o"),
        "loop_closure.min_gap_s": "0.1", "loop_closure.max_near": "5",
    }  # fmt: skip
    with StreamBench(tmp_path, own_domain_id(23), parameters) as bench:
        bench.play(clouds, 20.0)
        assert spin_until(bench.executor, lambda: bench.status()["worker"]["keyframes"] >= 2, PATIENCE_S)
        assert bench.status()["jobs"]["pending"] > 0
        assert_ends_within(2.0, bench.process)
        assert "Traceback" not in bench.process.output()
    assert len(read_g2o(tmp_path / "loops.g2o").poses) >= 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("loops")


@pytest.fixture(scope="module")
def bench(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        parameters = {**ROOM_PARAMETERS, "graph_file": str(folder / "room.g2o")}
        with StreamBench(folder, own_domain_id(22), parameters) as bench:
            yield bench


def walk(bench, start_s):
    """Out and back through the room; the counts when all is decided."""
    before = bench.status()["jobs"]["received"]
    clouds = [cloud(scan_room(sensor_pose(x, 0.0, 0.0), seed=k), start_s + 0.1 * k) for k, x in enumerate(WAY)]
    bench.play(clouds, 10.0)
    return wait_until_all_is_decided(bench, before + len(clouds), 30.0)


def test_loops_by_own_motion_and_their_graph(bench, folder):
    counts = walk(bench, 100.0)
    loops = list(bench.answers.decisions)
    assert loops
    assert {(d["verdict"], d["origin"]) for d in loops} == {("accepted", "odometry")}
    assert (loops[-1]["source_stamp"], loops[-1]["target_stamp"]) == ("100.600000000", "100.000000000")
    assert pose_error(candidate(loops[-1]), np.eye(4))[1] < 0.05
    assert counts["jobs"]["without_candidate"] == len(WAY) - len(loops)
    answer = bench.call(Trigger, "save_graph", Trigger.Request())
    assert answer.success
    assert str(folder / "room.g2o") in answer.message
    assert len(read_g2o(folder / "room.g2o").edges) == len(WAY) - 1 + len(loops)


def test_the_way_after_the_loops_is_a_path_for_who_subscribes(bench):
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    paths, latched = [], QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bench.node.create_subscription(Path, "/svc_registration/optimized_path", paths.append, latched)
    assert spin_until(bench.executor, lambda: paths, PATIENCE_S), bench.process.output()
    assert paths[-1].header.frame_id == "odom"
    assert [ns_from_stamp(p.header.stamp) for p in paths[-1].poses] == [
        round((100.0 + 0.1 * k) * SECOND) for k in range(len(WAY))
    ]
    for pose, x in zip(paths[-1].poses, WAY, strict=True):
        assert abs(pose.pose.position.x - x) < 0.1


def test_each_walk_after_a_reset_has_a_graph_of_its_own(bench, folder):
    for number in (1, 2):
        assert bench.call(Trigger, "reset", Trigger.Request()).success
        before = len(bench.answers.decisions)
        walk(bench, 1000.0 * number)
        assert len(bench.answers.decisions) > before
    assert bench.call(Trigger, "reset", Trigger.Request()).success
    assert {path.name for path in folder.glob("*.g2o")} == {"room.g2o", "room_2.g2o", "room_3.g2o"}
    assert len(read_g2o(folder / "room_3.g2o").poses) == len(WAY)


@pytest.fixture(scope="module")
def player(bench):
    player = CloudPlayer(bench.node, bench.executor, "/source_points", "/target_points")
    assert player.wait_for_subscribers(PATIENCE_S)
    return player


def propose(bench, player, source, target):
    stamp_ns = ns_from_stamp(source.header.stamp)
    player.publish(source, target)
    assert bench.collector.wait_for_decision_on(stamp_ns, PATIENCE_S), bench.process.output()
    return bench.decisions_on(stamp_ns)[-1]


def test_a_candidate_from_outside_is_judged(bench, player):
    decision = propose(bench, player, cloud(scan_room(POSES[1], 1), 1.0), cloud(scan_room(POSES[0], 0), 1.0))
    assert (decision["verdict"], decision["origin"]) == ("accepted", "given")
    assert pose_error(candidate(decision), pose_between(1, 0))[1] < 0.1


def test_a_good_guess_spares_the_search(bench, player):
    guesses = bench.node.create_publisher(PoseWithCovarianceStamped, "/initial_guess", 10)
    assert spin_until(bench.executor, guesses.get_subscription_count, PATIENCE_S)
    right = RegistrationResult(Verdict.ACCEPTED, Reason.OK, T_target_source=pose_between(1, 0))
    guesses.publish(pose_message(right, 2 * SECOND, "lidar"))
    bench.settle()
    decision = propose(bench, player, cloud(scan_room(POSES[1], 1), 2.0), cloud(scan_room(POSES[0], 0), 2.0))
    assert decision["verdict"] == "accepted"
    assert "counts.hypotheses" not in decision


def test_a_candidate_that_cannot_be_used_says_which_side(bench, player):
    broken = cloud(scan_room(POSES[0], 0), 3.0)
    broken.fields[1].name = "height"
    decision = propose(bench, player, cloud(scan_room(POSES[1], 1), 3.0), broken)
    assert (decision["verdict"], decision["reason"]) == ("rejected", "unsupported_cloud")
    assert decision["detail"].startswith("target: ")


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 12])
def test_candidates_between_different_places_are_not_accepted(shared_data, bench, player, count):
    read = read_dataset(shared_data / "pairs" / "hdl64_kitti_negatives")
    for k, pair in enumerate(read.negatives[:count]):
        source, target = (cloud(read.read_scan(name).points, 10.0 + k) for name in (pair.source, pair.target))
        assert propose(bench, player, source, target)["verdict"] in ("rejected", "undecided")
