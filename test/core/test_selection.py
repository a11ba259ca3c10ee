"""Each method chooses as it says: the first, the first that passes, the one that looks best."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import assert_same_bits, assert_same_pose
from correspondence_cases import KITTI_PAIRS, read_kitti_case
from scan_cases import T_ROOM, real_pair, room_config, room_scans

from svc_ros.core import decision, methods, se3, selection
from svc_ros.core.config import METHODS, preset, with_values
from svc_ros.core.matches.matching import match
from svc_ros.core.pair import Pair
from svc_ros.core.registration import extract_features, register, verify
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.search import shortlist
from svc_ros.core.search.hypotheses import generate_hypotheses
from svc_ros.core.sight import paper_rule
from svc_ros.core.stopwatch import Stopwatch
from svc_ros.io.clouds.files import read_scan


@pytest.fixture(scope="module")
def room():
    return tuple(extract_features(scan, room_config()) for scan in room_scans())


@pytest.fixture(scope="module")
def room_hypotheses(room):
    correspondences = match(*room, room_config().matching)
    return correspondences, generate_hypotheses(correspondences, room_config().hypotheses)


def away(x: float) -> np.ndarray:
    """A pose `x` metres beside the right one."""
    return se3.make_pose(np.eye(3), (x, 0, 0)) @ T_ROOM


def test_every_method_of_the_config_can_choose_and_verify():
    assert set(METHODS) == set(methods.METHODS) == set(methods.VERIFIERS)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_room(room, method):
    result = register(*room, room_config(method=method, paper__max_blocked_ratio=0.1))
    assert (result.verdict, result.reason, result.method) == (Verdict.ACCEPTED, Reason.OK, method)
    assert_same_pose(result.T_target_source, T_ROOM, 3.0, 0.3)  # two of the three do not refine on the surfaces
    assert_same_bits(result.T_target_source, result.best_candidate)
    assert 0.0 <= result.probability <= 1.0
    assert result.evidence.overlap_ratio > 0.5
    assert result.counts["hypotheses"] > 10
    assert result.counts["source_points"] == len(room[0])


def test_sc2_is_the_first_hypothesis_refined_on_the_correspondences(room, room_hypotheses):
    config, (correspondences, found) = room_config(method="sc2"), room_hypotheses
    expected = shortlist.refine_on_correspondences(
        found.T_target_source[0], correspondences, config.hypotheses, config.shortlist
    )
    result = register(*room, config)
    assert_same_bits(result.T_target_source, expected)
    assert result.probability == found.num_inliers[0] / len(correspondences)


def test_sc2_accepts_whatever_it_is_shown(room):
    result = verify(*room, away(25.0), room_config(method="sc2"))
    assert result.verdict is Verdict.ACCEPTED
    assert_same_pose(result.T_target_source, away(25.0), 1e-4, 1e-9)


def test_the_paper_rejects_with_the_first_hypothesis_when_nothing_passes(room, room_hypotheses):
    result = register(*room, room_config(method="svc_paper", paper__max_blocked_ratio=0.0, paper__max_hypotheses=7))
    assert (result.verdict, result.reason) == (Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
    assert result.T_target_source is None
    assert_same_bits(result.best_candidate, room_hypotheses[1].T_target_source[0])
    assert result.counts["judged"] == 7


def test_the_paper_takes_the_first_hypothesis_that_passes_both_ways(room, room_hypotheses):
    poses, scans = room_hypotheses[1].T_target_source, [features.prepared for features in room]
    limits = room_config().paper
    shares = [[lines.blocked_ratio for lines in paper_rule.check_both_ways(*scans, T, limits)[:2]] for T in poses[:40]]
    worst = np.max(shares, axis=1)
    bound = float(np.sort(worst)[3]) + 1e-9  # only four of forty pass
    result = register(*room, room_config(method="svc_paper", paper__max_blocked_ratio=bound))
    first = int(np.argmax(worst < bound))
    assert result.verdict is Verdict.ACCEPTED
    assert_same_bits(result.T_target_source, poses[first])
    assert result.counts["judged"] == first + 1
    assert max(result.evidence.numbers()[f"blocked_ratio_{way}"] for way in ("source_in_target", "target_in_source")) \
        == pytest.approx(worst[first])  # fmt: skip


@pytest.mark.parametrize("x", [0.0, 0.3, 1.0, -1.0, 3.5])
@pytest.mark.parametrize("bound", [0.005, 0.02, 0.1])
def test_the_paper_verifies_by_its_own_rule(room, x, bound):
    config = room_config(method="svc_paper", paper__max_blocked_ratio=bound)
    scans = [features.prepared for features in room]
    in_target, in_source, passed = paper_rule.check_both_ways(*scans, away(x), config.paper)
    result = verify(*room, away(x), config)
    assert result.accepted is passed
    assert passed is (max(in_target.blocked_ratio, in_source.blocked_ratio) < bound)
    assert_same_pose(result.best_candidate, away(x), 1e-4, 1e-9)
    assert result.evidence.source_in_target.num_blocked == in_target.num_blocked
    assert result.evidence.target_in_source.num_blocked == in_source.num_blocked


def test_the_default_accepts_the_right_pose_and_no_other(room):
    right = verify(*room, T_ROOM, room_config())
    assert right.verdict is Verdict.ACCEPTED
    assert_same_pose(right.T_target_source, T_ROOM, 1.0, 0.1)
    wrong = verify(*room, away(3.5), room_config())
    assert wrong.verdict is not Verdict.ACCEPTED
    assert wrong.T_target_source is None
    assert wrong.best_candidate is not None
    assert wrong.reason is not Reason.OK


def test_the_default_refines_what_it_is_given(room):
    start = away(0.15)
    result = verify(*room, start, room_config())
    assert result.verdict is Verdict.ACCEPTED
    assert se3.pose_error(result.T_target_source, T_ROOM)[1] < 0.05


# The default's parts


def pair_of(room, **values: object) -> Pair:
    source, target = (features.prepared for features in room)
    return Pair(source, target, room_config(**values), {}, Stopwatch())


def settled_at(pair: Pair, T: np.ndarray) -> selection.Settled:
    return selection._with_slips(pair, T, *pair.look_and_touch(T))


def test_poses_are_ranked_by_the_smallest_margin_of_a_glance(room):
    pair, poses = pair_of(room), [away(x) for x in (0.0, 0.5, 2.0, 25.0)]
    glances = pair.glance_at_all(poses)
    promises = [pair.promise(seen) for seen in glances]
    assert promises[0] == max(promises)
    assert promises[-1] == min(promises)
    for T, seen, promise in zip(poses, glances, promises, strict=True):
        whole = pair.look(T)
        assert (seen.denied_ratio, seen.weakest_constraint) == (whole.denied_ratio, whole.weakest_constraint)
        assert seen.source_in_target.num_lines == 0 < whole.source_in_target.num_lines
        assert promise == decision.measure_margins(whole, pair.config.decision).smallest
    assert pair.glance_at_all([]) == []


def test_a_look_that_touches_sees_what_a_look_sees(room):
    pair = pair_of(room)
    assert pair.look_and_touch(away(0.2))[0].numbers() == pair.look(away(0.2)).numbers()


@pytest.mark.parametrize("slip_m", [0.5, 2.4])
def test_the_pose_is_shifted_both_ways_by_the_slip_and_by_half_of_it(room, slip_m):
    pair = pair_of(room, decision__weak_constraint=1.0, decision__slip_m=slip_m)  # so that every direction is weak
    settled = settled_at(pair, T_ROOM)
    assert len(settled.far_slips) == len(settled.near_slips) > 0
    for slips, distance in ((settled.far_slips, slip_m), (settled.near_slips, 0.5 * slip_m)):
        shifts = np.array([T[:3, 3] - T_ROOM[:3, 3] for T, _ in slips])
        np.testing.assert_allclose(np.linalg.norm(shifts, axis=1), distance)
        np.testing.assert_allclose(shifts[::2], -shifts[1::2], atol=1e-9)
        for T, seen in slips:
            np.testing.assert_array_equal(T[:3, :3], T_ROOM[:3, :3])
            whole = pair.look(T)
            if decision.is_far_worse(seen, settled.evidence, pair.config.decision):  # few points were enough
                assert decision.score(whole) < decision.score(settled.evidence)
                assert seen.denied_ratio == pytest.approx(whole.denied_ratio, abs=0.06)
            else:
                assert seen.denied_ratio == whole.denied_ratio


def test_a_pose_is_shifted_along_the_weakest_direction_and_along_whatever_else_is_weak(room):
    firmly, weakly = (settled_at(pair_of(room, decision__weak_constraint=c), T_ROOM) for c in (0.0, 1.0))
    assert (len(firmly.far_slips), len(firmly.near_slips)) == (2, 0)
    assert len(weakly.far_slips) > 2
    for (T, _), (also, _) in zip(firmly.far_slips, weakly.far_slips, strict=False):
        assert_same_bits(T, also)


def test_where_a_slip_looks_better_refinement_starts_from_there(room):
    """From a metre beside the right pose, with an ICP that reaches no farther than it stands."""
    pair = pair_of(
        room, decision__weak_constraint=1.0, decision__slip_m=1.0, shortlist__icp_rounds=3,
        shortlist__icp_distance_m=0.3,
    )  # fmt: skip
    start = away(1.0)
    assert se3.pose_error(pair.refine(start, 3000), T_ROOM)[1] > 0.7
    assert se3.pose_error(selection._settle(pair, start).T_target_source, T_ROOM)[1] < 0.3


def test_the_papers_answer_keeps_what_was_seen_of_the_surfaces(room):
    result = verify(*room, T_ROOM, room_config(method="svc_paper"))
    seen = pair_of(room, method="svc_paper").look(T_ROOM)
    for name in ("denied_ratio", "wide_denied_ratio", "weakest_constraint", "tight_ratio", "overlap_ratio"):
        assert getattr(result.evidence, name) == getattr(seen, name)
    assert result.evidence.source_surface.num_confirmed > 100


def test_sc2_on_real_correspondences_of_scans_ten_metres_apart(shared_data):
    """Within 5 deg and 0.6 m in at least 10 of 11, with 0.75 to 3.4 % right correspondences."""
    config = with_values(preset("lidar_outdoor"), {"method": "sc2"})
    folder, errors = shared_data / "correspondences" / "kitti_10m_fpfh", {}
    for pair in KITTI_PAIRS:
        correspondences, T = read_kitti_case(shared_data, pair)
        source, target = (read_scan(folder / f"{pair}_pts_{side}.ply") for side in ("src", "dst"))
        result = register(source, target, config, correspondences=correspondences)
        errors[pair] = se3.pose_error(result.T_target_source, T)
    right = [pair for pair, (angle, distance) in errors.items() if angle < 5.0 and distance < 0.6]
    assert len(errors) == 11
    assert len(right) >= 10, f"right are {right}, errors [deg], [m]: {errors}"


@pytest.mark.parametrize("folder", ["os1_64_seosan", "hdl64_kitti_a", "rgbd_redkitchen"])
def test_the_default_on_real_scans(shared_data, folder):
    source, target, T, config = real_pair(shared_data, folder)
    result = register(source, target, config)
    limits = (15.0, 0.3) if folder == "rgbd_redkitchen" else (5.0, 0.6)
    assert_same_pose(result.best_candidate, T, *limits)
    assert result.evidence.overlap_ratio > 0.3
