"""Loops: right ones found with good, drifted and no odometry; never one between different places; bounded."""

from __future__ import annotations

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mini_data import scan_room, sensor_pose
from scipy.spatial.transform import Rotation
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Scan
from svc_ros.io.bags import Bag
from svc_ros.io.datasets import read_dataset
from svc_ros.io.results import result_to_json
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.pipeline import loop_closure
from svc_ros.pipeline.loop_closure import LoopCloser, LoopQuestion, judge_scans
from svc_ros.pipeline.stream import StreamDecision

S = 1_000_000_000
CONFIG = with_values(preset("lidar_indoor"), {"loop_closure.min_gap_s": 5.0, "loop_closure.keyframe_distance_m": 0.5})
ALONG = (-3.0, -2.0, -1.0, 0.0, 1.0)
OUT_AND_BACK = [sensor_pose(x, 0.0, 0.0) for x in ALONG] + [sensor_pose(x, 0.0, 180.0) for x in reversed(ALONG)]


def room_scan(k: int) -> Scan:
    return Scan(scan_room(OUT_AND_BACK[k], seed=k), k * S, "lidar")


def room_loops(closer: LoopCloser, drift: np.ndarray | None = None, with_odometry: bool = True) -> list[StreamDecision]:
    decisions = []
    for k, T in enumerate(OUT_AND_BACK):
        pose = np.linalg.matrix_power(np.eye(4) if drift is None else drift, k) @ T
        decisions += closer.add(room_scan(k), pose if with_odometry else None)
    return decisions


def true_pose(decision: StreamDecision) -> np.ndarray:
    source, target = (OUT_AND_BACK[ns // S] for ns in (decision.source_stamp_ns, decision.target_stamp_ns))
    return se3.invert(target) @ source


def assert_right(decisions: list[StreamDecision]) -> None:
    for decision in decisions:
        angle, distance = se3.pose_error(decision.result.T_target_source, true_pose(decision))
        assert angle < 1.0
        assert distance < 0.1


def test_the_way_back_closes_loops_by_odometry() -> None:
    decisions = room_loops(LoopCloser(CONFIG))
    assert {d.origin for d in decisions} == {"odometry"}
    assert len({d.source_stamp_ns for d in decisions}) == len(decisions) == 5
    assert all(d.result.accepted for d in decisions)
    assert_right(decisions)


def test_drifted_odometry_still_leads_to_the_loops() -> None:
    drift = se3.make_pose(Rotation.from_euler("z", 3.0, degrees=True).as_matrix(), (0.1, 0.05, 0.0))
    accepted = [d for d in room_loops(LoopCloser(CONFIG), drift) if d.result.accepted]
    assert len(accepted) >= 4
    assert_right(accepted)


def test_without_odometry_the_look_of_the_place_leads_to_them() -> None:
    decisions = room_loops(LoopCloser(CONFIG), with_odometry=False)
    assert {d.origin for d in decisions} == {"place"}
    accepted = [d for d in decisions if d.result.accepted]
    assert len(accepted) >= 3
    assert_right(accepted)


def test_the_scans_of_a_loop_are_far_apart_in_time() -> None:
    decisions = room_loops(LoopCloser(with_values(CONFIG, {"loop_closure.min_gap_s": 8.0})))
    assert decisions
    assert all(d.source_stamp_ns - d.target_stamp_ns >= 8 * S for d in decisions)


def test_far_keyframes_are_no_candidates() -> None:
    values = {"loop_closure.max_distance_m": 0.3, "loop_closure.max_similar": 0}
    decisions = room_loops(LoopCloser(with_values(CONFIG, values)))
    assert [(d.source_stamp_ns // S, d.target_stamp_ns // S) for d in decisions] == [(7, 2), (8, 1), (9, 0)]


@pytest.mark.parametrize(("error_m", "accepted"), [(0.1, True), (2.0, False)])
def test_a_keyframe_behind_the_sensor_is_verified_at_the_pose_of_odometry(error_m: float, accepted: bool) -> None:
    """Twenty metres along a corridor the probability of a pair is low, and a registration finds it turned around."""

    def unwanted(*_: object) -> RegistrationResult:
        raise AssertionError("a registration was asked for")

    closer = LoopCloser(with_values(preset("lidar_indoor"), {"loop_closure.max_similar": 0}), unwanted)
    (first, T_first), (last, T_last) = (scan_at(Place("indoor", "OS0-64", 1, way_m)) for way_m in (3.0, 23.0))
    T_odom_last = T_last @ se3.make_pose(np.eye(3), (error_m, 0.0, 0.0))
    assert closer.add(dataclasses.replace(first, stamp_ns=1 * S, frame_id="lidar"), T_first) == []
    told = closer.add(dataclasses.replace(last, stamp_ns=22 * S, frame_id="lidar"), T_odom_last)
    assert {d.origin for d in told[:1]} == {"odometry"}
    assert told[-1].result.accepted is accepted
    if accepted:
        _, distance = se3.pose_error(told[-1].result.T_target_source, se3.invert(T_first) @ T_last)
        assert distance < 0.3


def test_a_registration_replaces_no_likely_guess_by_an_unlikely_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    likely, unlikely = (
        RegistrationResult(Verdict.ACCEPTED if p > 0.5 else Verdict.UNDECIDED, Reason.OK, "svc", np.eye(4) if p > 0.5
                           else None, np.eye(4), np.eye(6) if p > 0.5 else None, p)
        for p in (0.7, 0.1)
    )  # fmt: skip
    monkeypatch.setattr(loop_closure, "register_pair", lambda *_: unlikely)
    scans = [room_scan(k) for k in (0, 1)]
    monkeypatch.setattr(loop_closure, "verify", lambda *_: likely)
    found = judge_scans(*scans, np.eye(4), CONFIG)
    assert (found.verdict, found.probability) == (Verdict.UNDECIDED, 0.7)
    monkeypatch.setattr(loop_closure, "verify", lambda *_: unlikely)
    assert judge_scans(*scans, np.eye(4), CONFIG) is unlikely


def test_numbers_of_candidates_are_limits() -> None:
    none = with_values(CONFIG, {"loop_closure.max_near": 0, "loop_closure.max_similar": 0})
    assert room_loops(LoopCloser(none)) == []
    three = with_values(CONFIG, {"loop_closure.max_near": 3})
    assert sum(d.source_stamp_ns == 9 * S for d in room_loops(LoopCloser(three))) == 3


def test_a_sensor_that_stands_adds_no_keyframes() -> None:
    closer = LoopCloser(CONFIG)
    for k in range(4):
        closer.add(Scan(scan_room(OUT_AND_BACK[0], seed=k), k * S, "lidar"), OUT_AND_BACK[0])
    assert closer.num_keyframes == 1
    turned = OUT_AND_BACK[0] @ sensor_pose(0, 0, 90.0)
    turned[2, 3] = 1.2
    closer.add(Scan(scan_room(turned), 5 * S, "lidar"), turned)
    assert closer.num_keyframes == 2


def test_keyframes_are_bounded_but_their_poses_are_remembered() -> None:
    closer = LoopCloser(with_values(CONFIG, {"loop_closure.max_keyframes": 3}))
    room_loops(closer)
    assert closer.num_keyframes == 3
    assert len(closer.keyframe_poses) == len(OUT_AND_BACK)
    np.testing.assert_array_equal(closer.keyframe_poses.at(4 * S), OUT_AND_BACK[4])


def test_broken_scans_and_poses_are_decisions() -> None:
    closer = LoopCloser(CONFIG)
    (few,) = closer.add(Scan(np.ones((5, 3)), 1 * S, "lidar"))
    (no_pose,) = closer.add(Scan(scan_room(OUT_AND_BACK[0]), 2 * S, "lidar"), np.full((4, 4), np.nan))
    (late,) = closer.add(Scan(scan_room(OUT_AND_BACK[0]), 2 * S, "lidar"))
    assert few.result.reason is Reason.TOO_FEW_POINTS
    assert (no_pose.result.reason, "T_odom_scan" in no_pose.result.detail) == (Reason.UNSUPPORTED_CLOUD, True)
    assert (late.result.verdict, late.result.reason) == (Verdict.DROPPED, Reason.STALE)
    assert closer.num_keyframes == 0


def test_a_jump_in_time_forgets_everything() -> None:
    closer = LoopCloser(CONFIG)
    room_loops(closer)
    assert closer.add(room_scan(0), OUT_AND_BACK[0]) == []
    assert closer.num_keyframes == 1
    assert len(closer.keyframe_poses) == 1


def test_a_guess_is_verified_and_a_wrong_one_replaced() -> None:
    source, target = room_scan(8), room_scan(1)
    T = se3.invert(OUT_AND_BACK[1]) @ OUT_AND_BACK[8]
    for guess in (T, np.eye(4), None):
        result = judge_scans(source, target, guess, CONFIG)
        assert result.accepted
        assert se3.pose_error(result.T_target_source, T)[1] < 0.1
    assert judge_scans(source, target, np.zeros((4, 4)), CONFIG).reason is Reason.UNSUPPORTED_CLOUD
    assert judge_scans(Scan(np.ones((5, 3))), target, None, CONFIG).reason is Reason.TOO_FEW_POINTS


def answer_of(decision: StreamDecision) -> str:
    """All that is told of it but the time it took; numbers as they are, to the last bit."""
    told = result_to_json(decision.result, source=decision.source_stamp_ns, target=decision.target_stamp_ns)
    covariance = decision.result.covariance
    bits = "" if covariance is None else covariance.tobytes().hex()
    return json.dumps([{key: value for key, value in told.items() if key != "time_ms"}, decision.origin, bits])


@pytest.mark.slow
@pytest.mark.parametrize("with_odometry", [True, False])
def test_judging_in_several_threads_gives_the_same_bits(with_odometry: bool) -> None:
    """Of keyframes that several questions share as targets, and that are a source and a target at once."""
    values = {"loop_closure.min_gap_s": 1.0, "loop_closure.max_near": 2, "loop_closure.max_similar": 2,
              "loop_closure.min_probability": 0.995, "matching.more_descriptors": "fpfh_wide"}  # fmt: skip
    config = with_values(CONFIG, values)
    in_one_step = LoopCloser(config)
    one_by_one = room_loops(in_one_step, with_odometry=with_odometry)
    closer = LoopCloser(config)
    proposed = [closer.propose(room_scan(k), T if with_odometry else None) for k, T in enumerate(OUT_AND_BACK)]
    questions = [found for found in proposed if isinstance(found, LoopQuestion)]
    with ThreadPoolExecutor(4) as pool:
        at_once = list(pool.map(closer.judge, reversed(questions)))
    assert [answer_of(d) for found in reversed(at_once) for d in found] == [answer_of(d) for d in one_by_one]
    assert len(one_by_one) > len(questions) > 5
    assert {d.result.verdict for d in one_by_one} >= {Verdict.UNDECIDED}
    np.testing.assert_array_equal(closer.keyframe_poses.poses, in_one_step.keyframe_poses.poses)


def test_what_is_proposed_is_judged_as_it_was_whatever_the_closer_does_meanwhile() -> None:
    closer, wanted = LoopCloser(CONFIG), room_loops(LoopCloser(CONFIG))
    questions = [closer.propose(room_scan(k), T) for k, T in enumerate(OUT_AND_BACK)]
    closer.reset()
    assert closer.num_keyframes == 0
    judged = [d for question in questions if isinstance(question, LoopQuestion) for d in closer.judge(question)]
    assert [answer_of(d) for d in judged] == [answer_of(d) for d in wanted]


def test_an_exception_while_judging_is_a_decision() -> None:
    def fail(*_: object) -> RegistrationResult:
        raise RuntimeError("boom")

    decisions = room_loops(LoopCloser(CONFIG, fail))
    assert {d.result.reason for d in decisions} == {Reason.INTERNAL_ERROR}
    assert [d.source_stamp_ns // S for d in decisions] == [5, 6, 7, 8, 9]


@pytest.mark.slow
def test_forced_candidates_between_different_streets_are_not_accepted(shared_data: Path) -> None:
    dataset = read_dataset(shared_data / "pairs" / "hdl64_kitti_negatives")
    config = with_values(preset(dataset.preset), {"preprocess.min_range_m": dataset.min_range_m})
    for k, pair in enumerate(dataset.negatives[:6]):
        guess = np.eye(4) if k % 2 else None
        result = judge_scans(dataset.read_scan(pair.source), dataset.read_scan(pair.target), guess, config)
        assert result.verdict in (Verdict.REJECTED, Verdict.UNDECIDED)


def test_forced_candidates_between_simulated_places_are_not_accepted() -> None:
    scans = [scan_at(Place("indoor", "VLP-16", seed, 20.0))[0] for seed in range(6)]
    for source, target in pairwise(scans):
        assert not judge_scans(source, target, np.eye(4), preset("lidar_indoor")).accepted


def walk_loops(shared_data: Path, odometry: Trajectory, config: Config) -> tuple[list[StreamDecision], Trajectory]:
    folder = shared_data / "bags" / "os0_64_walk"
    closer = LoopCloser(config)
    with Bag(folder / "ros2_mcap") as bag:
        decisions = [
            decision
            for reading in bag.scans()
            for decision in closer.add(reading.scan, odometry.at(reading.scan.stamp_ns))
        ]
    return decisions, read_tum(folder / "reference_tum.txt")


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [0.0, 0.5])
def test_a_walk_has_many_right_loops_and_no_wrong_one(shared_data: Path, turn_deg: float) -> None:
    """With the recorded odometry, and with one that turns by half a degree more each half second."""
    odometry = read_tum(shared_data / "bags" / "os0_64_walk" / "odometry_tum.txt")
    turns = Rotation.from_euler("z", turn_deg * np.arange(len(odometry))[:, None], degrees=True).as_matrix()
    drifted = Trajectory(odometry.stamps_ns, se3.make_pose(turns, np.zeros((len(odometry), 3))) @ odometry.poses)
    decisions, reference = walk_loops(shared_data, drifted, preset("lidar_indoor"))
    accepted = [d for d in decisions if d.result.accepted]
    assert len(accepted) >= 20
    for decision in accepted:
        assert decision.source_stamp_ns - decision.target_stamp_ns >= 20 * S
        T = se3.invert(reference.at(decision.target_stamp_ns)) @ reference.at(decision.source_stamp_ns)
        angle, distance = se3.pose_error(decision.result.T_target_source, T)
        assert angle < 5.0
        assert distance < 0.6
