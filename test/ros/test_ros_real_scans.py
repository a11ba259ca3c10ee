"""Real scans over the real middleware, to the node in a second process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rclpy.qos import qos_profile_sensor_data
from ros_bench import SECOND, Bench, cloud, matrix
from sensor_msgs.msg import PointCloud2
from yardstick import PATIENCE_S, assert_ends_within

from svc_ros.core.se3 import pose_error
from svc_ros.io.datasets import read_dataset
from svc_ros.ros.collector import spin_until
from svc_ros.ros.middleware import SOCKET_BUFFER, largest_socket_buffer
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

NUM_PAIRS, NUM_NEGATIVES = 3, 2
SIDES = ("source", "target")


@dataclass(frozen=True)
class Case:
    """A pair of real scans; T_target_source is None for scans of different places."""

    source: np.ndarray
    target: np.ndarray
    T_target_source: np.ndarray | None


def read_cases(shared_data, num_pairs: int = NUM_PAIRS, num_negatives: int = NUM_NEGATIVES) -> list[Case]:
    same, other = (read_dataset(shared_data / "pairs" / name) for name in ("hdl64_kitti_a", "hdl64_kitti_negatives"))
    pairs = sorted(same.pairs, key=lambda p: -p.overlap)[:num_pairs]
    cases = [(same, p, p.T_target_source) for p in pairs]
    cases += [(other, p, None) for p in other.negatives[:num_negatives]]
    return [Case(d.read_scan(p.source).points, d.read_scan(p.target).points, T) for d, p, T in cases]


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with Bench(tmp_path, own_domain_id(4), {"preset": "lidar_outdoor", "process_every": "true"}) as bench:
        yield bench


def test_plays_real_scans_and_gets_one_decision_a_pair(shared_data, bench):
    cases = read_cases(shared_data)
    for k, case in enumerate(cases, 1):  # all at once: the node's queue is tested too
        bench.player.publish(cloud(case.source, k), cloud(case.target, k))
        bench.pause(0.05)
    assert bench.collector.wait_for_decisions(len(cases), PATIENCE_S), bench.process.output()
    bench.settle()

    assert all(d["source_stamp"] and d["target_stamp"] for d in bench.answers.decisions), bench.answers.decisions
    decisions = {round(float(d["source_stamp"])): d for d in bench.answers.decisions}
    assert len(bench.answers.decisions) == len(cases)
    assert sorted(decisions) == list(range(1, len(cases) + 1))
    accepted = {k for k, d in decisions.items() if d["verdict"] == "accepted"}
    negatives = {k for k, case in enumerate(cases, 1) if case.T_target_source is None}
    assert not accepted & negatives, decisions
    assert len(accepted) >= NUM_PAIRS - 1, decisions

    transforms = {round(t.header.stamp.sec + t.header.stamp.nanosec / SECOND): t for t in bench.answers.transforms}
    assert sorted(transforms) == sorted(accepted)
    assert len(bench.answers.transforms) == len(bench.answers.poses) == len(accepted)
    for k in accepted:
        rotation_deg, translation_m = pose_error(matrix(transforms[k]), cases[k - 1].T_target_source)
        assert rotation_deg < 5.0
        assert translation_m < 0.6

    # rejected comes in the order of the decisions, which is the order of the pairs
    assert bench.answers.rejected == [k not in accepted for k in decisions]
    assert all(bench.answers.rejected[k - 1] for k in negatives)


@pytest.mark.slow
def test_pairs_that_a_driver_sends_best_effort_all_arrive_and_are_decided_rightly(shared_data, tmp_path, monkeypatch):
    largest = largest_socket_buffer()
    if largest is not None and largest < SOCKET_BUFFER:
        pytest.skip(f"the kernel allows sockets {largest} bytes, expected {SOCKET_BUFFER} (net.core.rmem_max)")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    best_effort = {f"qos_overrides./{side}_points.subscription.reliability": "best_effort" for side in SIDES}
    cases = read_cases(shared_data, 8, 6)
    with Bench(tmp_path, own_domain_id(14), {"preset": "lidar_outdoor", **best_effort}) as bench:
        publishers = [
            bench.node.create_publisher(PointCloud2, f"/{side}_points", qos_profile_sensor_data) for side in SIDES
        ]
        assert spin_until(bench.executor, lambda: all(p.get_subscription_count() for p in publishers), PATIENCE_S)
        bench.settle()
        for k, case in enumerate(cases, 1):
            for publisher, points in zip(publishers, (case.source, case.target), strict=True):
                publisher.publish(cloud(points, k))
            assert bench.collector.wait_for_decisions(k, PATIENCE_S), bench.process.output()
        bench.settle()
        accepted = {round(float(d["source_stamp"])) for d in bench.answers.decisions if d["verdict"] == "accepted"}
    assert len(bench.answers.decisions) == len(cases)
    assert accepted == {k for k, case in enumerate(cases, 1) if case.T_target_source is not None}
    for transform in bench.answers.transforms:
        rotation_deg, translation_m = pose_error(
            matrix(transform), cases[transform.header.stamp.sec - 1].T_target_source
        )
        assert (rotation_deg < 5.0, translation_m < 0.6) == (True, True)


@pytest.mark.slow
def test_ctrl_c_in_the_middle_of_a_pair_ends_the_node(shared_data, bench):
    case = read_cases(shared_data)[0]
    for stamp in (1, 2, 3):
        bench.player.publish(cloud(case.source + stamp, stamp), cloud(case.target + stamp, stamp))
    bench.pause(0.6)
    assert_ends_within(2.0, bench.process)
    assert "Traceback" not in bench.process.output()
