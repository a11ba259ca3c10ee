"""Scan matching: one decision a scan, poses that are right or not told, recovery, and nothing kept without bound."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mini_data import scan_room, sensor_pose
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Scan
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.pipeline.stream import StreamDecision
from svc_ros.simulation.drive import DriveConfig, drive_scans

CONFIG = preset("lidar_indoor")
STEP_NS = 100_000_000
TRACK = [sensor_pose(0.1 * k, 0.05 * k, 3.0 * k) for k in range(40)]


def room_at(k: int, stamp_ns: int | None = None) -> Scan:
    return Scan(scan_room(TRACK[k], seed=k), k * STEP_NS + 1 if stamp_ns is None else stamp_ns, "lidar")


def match(scans: list[Scan], matcher: ScanMatcher | None = None) -> list[StreamDecision]:
    matcher = matcher or ScanMatcher(CONFIG)
    decisions = [decision for scan in scans for decision in matcher.add(scan)]
    assert [d.source_stamp_ns for d in decisions] == [s.stamp_ns for s in scans]  # one each, in order
    return decisions


def errors(decisions: list[StreamDecision], poses: list[np.ndarray]) -> list[tuple[float, float]]:
    """(deg, m) of every told pose against the reference, which starts at the first scan."""
    T_first = se3.invert(poses[0])
    return [
        se3.pose_error(d.T_odom_source, T_first @ T)
        for d, T in zip(decisions, poses, strict=True)
        if d.T_odom_source is not None
    ]


def assert_none_wrong(decisions: list[StreamDecision], poses: list[np.ndarray], limits: tuple[float, float]) -> None:
    for angle, distance in errors(decisions, poses):
        assert angle < limits[0]
        assert distance < limits[1]
    for decision in decisions:
        assert (decision.T_odom_source is not None) == decision.result.accepted


def real_scans(bag_path: Path, reference: Trajectory) -> tuple[list[Scan], list[np.ndarray]]:
    with Bag(bag_path) as bag:
        scans = [reading.scan for reading in bag.scans()]
    return scans, [reference.at(scan.stamp_ns) for scan in scans]


@pytest.fixture(scope="module")
def walk(shared_data: Path) -> tuple[list[Scan], list[np.ndarray]]:
    folder = shared_data / "bags" / "os0_64_walk"
    return real_scans(folder / "ros2_mcap", read_tum(folder / "reference_tum.txt"))


def test_a_room_is_walked_through() -> None:
    decisions = match([room_at(k) for k in range(6)])
    assert all(d.result.accepted for d in decisions)
    assert [d.origin for d in decisions] == ["start"] + 5 * ["motion"]
    assert_none_wrong(decisions, TRACK[:6], (0.5, 0.05))


def test_every_pose_comes_with_its_evidence_target_and_covariance() -> None:
    first, second = match([room_at(0), room_at(1)])
    assert (second.target_stamp_ns, second.target_frame) == (first.source_stamp_ns, "lidar")
    assert second.result.evidence is not None
    np.testing.assert_allclose(second.T_odom_source, second.result.T_target_source, atol=1e-9)
    for decision in (first, second):
        assert np.linalg.eigvalsh(decision.result.covariance)[0] > 0
    np.testing.assert_array_equal(first.T_odom_source, np.eye(4))


def test_the_same_scans_give_the_same_bits() -> None:
    runs = [match([room_at(k) for k in (0, 1, 2, 9, 10)]) for _ in range(2)]
    for first, second in zip(*runs, strict=True):
        assert (first.result.verdict, first.origin) == (second.result.verdict, second.origin)
        np.testing.assert_array_equal(first.T_odom_source, second.T_odom_source)


def test_a_turn_that_no_velocity_foretells_is_found() -> None:
    poses = [sensor_pose(0, 0, 0), sensor_pose(0.1, 0, 0), sensor_pose(0.2, 0, 80.0)]
    scans = [Scan(scan_room(T, seed=k), k * STEP_NS, "lidar") for k, T in enumerate(poses)]
    decisions = match(scans)
    assert decisions[-1].result.accepted
    assert decisions[-1].origin == "turn"
    assert_none_wrong(decisions, poses, (0.5, 0.05))


def test_a_lost_sensor_is_found_by_registration() -> None:
    config = with_values(CONFIG, {"scan_matching.max_iterations": 1})  # a motion that never arrives
    poses = [sensor_pose(0, 0, 0), sensor_pose(2.0, 0.8, 100.0), sensor_pose(2.02, 0.8, 100.5)]
    scans = [Scan(scan_room(T, seed=k), k * STEP_NS, "lidar") for k, T in enumerate(poses)]
    decisions = match(scans, ScanMatcher(config))
    assert decisions[1].origin == "registration"
    assert all(d.result.accepted for d in decisions)
    assert_none_wrong(decisions, poses, (0.5, 0.05))


def test_without_recovery_a_lost_sensor_stays_lost() -> None:
    config = with_values(CONFIG, {"scan_matching.max_iterations": 1, "scan_matching.recovery_attempts": 0})
    poses = [sensor_pose(0, 0, 0), sensor_pose(2.0, 0.8, 100.0)]
    scans = [Scan(scan_room(T, seed=k), k * STEP_NS, "lidar") for k, T in enumerate(poses)]
    assert not match(scans, ScanMatcher(config))[1].result.accepted


def test_a_scan_that_cannot_be_used_changes_nothing() -> None:
    few = Scan(np.ones((5, 3)), 2 * STEP_NS, "lidar")
    other_frame = dataclasses.replace(room_at(3), frame_id="camera")
    with_them = match([room_at(0), room_at(1), few, other_frame, room_at(4)])
    without = match([room_at(0), room_at(1), room_at(4)])
    reasons = [d.result.reason for d in with_them]
    assert reasons[2:4] == [Reason.TOO_FEW_POINTS, Reason.UNSUPPORTED_CLOUD]
    assert "'lidar'" in with_them[3].result.detail
    np.testing.assert_array_equal(with_them[4].T_odom_source, without[2].T_odom_source)


def test_a_useless_first_scan_is_no_origin() -> None:
    few, first, second = match([Scan(np.ones((5, 3)), 0, "lidar"), room_at(1), room_at(2)])
    assert few.result.reason is Reason.TOO_FEW_POINTS
    assert first.origin == "start"
    assert second.result.accepted


def test_late_scans_are_dropped_and_jumps_begin_anew() -> None:
    matcher = ScanMatcher(CONFIG)
    start = 100 * STEP_NS
    stamps = [start, start + STEP_NS, start + STEP_NS, start, start - 50 * STEP_NS, start - 49 * STEP_NS]
    decisions = match([room_at(k, stamp) for k, stamp in enumerate(stamps)], matcher)
    assert [d.result.verdict for d in decisions[2:4]] == 2 * [Verdict.DROPPED]
    assert {d.result.reason for d in decisions[2:4]} == {Reason.STALE}
    assert [d.origin for d in decisions[4:]] == ["start", "motion"]
    np.testing.assert_array_equal(decisions[4].T_odom_source, np.eye(4))


def test_after_a_reset_the_next_scan_is_the_origin() -> None:
    matcher = ScanMatcher(CONFIG)
    match([room_at(0), room_at(1)], matcher)
    matcher.reset()
    assert matcher.num_keyframes == 0
    assert match([room_at(1)], matcher)[0].origin == "start"


def test_keyframes_are_bounded() -> None:
    values = {"scan_matching.keyframe_distance_m": 0.05, "scan_matching.max_keyframes": 3}
    matcher = ScanMatcher(with_values(CONFIG, values))
    decisions = match([room_at(k) for k in range(6)], matcher)
    assert matcher.num_keyframes == 3
    assert decisions[-1].target_stamp_ns == decisions[-2].source_stamp_ns


def test_in_another_place_nothing_is_accepted_until_the_sensor_is_back() -> None:
    """Street scans, three of another street that follow as if the sensor had driven on, and the first street again."""
    here = [scan_at(Place("street", "VLP-16", 1, 10.0 + k)) for k in range(5)]
    there = [scan_at(Place("street", "VLP-16", 7, 30.0 + k)) for k in range(3)]
    order = [*here[:3], *there, *here[3:]]
    scans = [dataclasses.replace(scan, stamp_ns=k * STEP_NS) for k, (scan, _) in enumerate(order)]
    decisions = match(scans, ScanMatcher(preset("lidar_outdoor")))
    assert [d.result.accepted for d in decisions] == 3 * [True] + 3 * [False] + 2 * [True]
    back = [d for d in decisions if d.result.accepted]
    assert_none_wrong(back, [T for _, T in here], (1.0, 0.3))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5, 6])
def test_a_room_that_is_much_alike_is_not_taken_for_the_last_one(seed: int) -> None:
    config = DriveConfig("indoor", "OS0-64", 9, 0.5, 2.0, seed, teleport_after=5)
    drive = list(drive_scans(config))
    decisions = match([Scan(s.cast.points, s.stamp_ns, "lidar") for s in drive])
    assert [d.result.accepted for d in decisions[:6]] == 6 * [True]
    assert [d.result.accepted for d in decisions[6:]] == 3 * [False]


@pytest.mark.parametrize("seed", [2, 3])
def test_in_a_corridor_small_errors_do_not_add_up(seed: int) -> None:
    """Rings on the floor go along with the sensor: each pose may be short of the way, all of them must not be."""
    drive = list(drive_scans(DriveConfig("corridor_features", "VLP-16", 15, 0.2, 5.0, seed)))
    decisions = match([Scan(s.cast.points, s.stamp_ns, "lidar") for s in drive])
    assert_none_wrong(decisions, [s.T_map_lidar for s in drive], (1.0, 0.45))
    assert decisions[-1].result.accepted
    assert errors(decisions, [s.T_map_lidar for s in drive])[-1][1] < 0.15


def test_a_street_is_driven_through(shared_data: Path) -> None:
    reference = read_tum(shared_data / "bags" / "hdl64_kitti_a_10hz_reference_tum.txt")
    scans, poses = real_scans(shared_data / "bags" / "hdl64_kitti_a_10hz", reference)
    decisions = match(scans, ScanMatcher(preset("lidar_outdoor")))
    assert len(decisions) == 22
    assert Counter(d.result.verdict for d in decisions) == {Verdict.ACCEPTED: 22}
    assert_none_wrong(decisions, poses, (1.0, 0.3))


@pytest.mark.slow
def test_a_walk_is_followed(walk: tuple[list[Scan], list[np.ndarray]]) -> None:
    """88 s at one scan a second, with turns of up to 90 deg between two scans."""
    scans, poses = walk
    decisions = match(scans)
    told = np.array(errors(decisions, poses))
    assert len(told) >= 85
    assert np.sqrt(np.mean(np.square(told[:, 1]))) < 0.5
    assert_none_wrong(decisions, poses, (2.0, 0.6))


@pytest.mark.parametrize("hole", [20, 40, 75])
def test_after_missing_five_seconds_the_pose_is_right_or_not_told(
    walk: tuple[list[Scan], list[np.ndarray]], hole: int
) -> None:
    scans, poses = walk
    kept = [*range(hole - 4, hole), *range(hole + 5, hole + 9)]
    decisions = match([scans[k] for k in kept])
    assert_none_wrong(decisions, [poses[k] for k in kept], (2.0, 0.3))
    assert decisions[-1].result.accepted


@pytest.mark.slow
def test_wherever_the_sensor_is_carried_the_pose_is_right_or_not_told(
    walk: tuple[list[Scan], list[np.ndarray]],
) -> None:
    scans, poses = walk
    found = 0
    for start, goal in ((0, 60), (15, 70), (33, 2), (50, 25), (66, 40), (80, 50)):
        order = [start, start + 1, start + 2, goal, goal + 1]
        carried = [dataclasses.replace(scans[k], stamp_ns=n * 1_000_000_000) for n, k in enumerate(order)]
        decisions = match(carried)
        assert_none_wrong(decisions, [poses[k] for k in order], (2.0, 0.5))
        found += decisions[-1].result.accepted
    assert found >= 4
