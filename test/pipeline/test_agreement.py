"""Loops held against each other: right ones stay or become accepted, wrong ones go, and each change is a decision."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.io.results import result_to_json
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline import agreement as agreement_module
from svc_ros.pipeline.agreement import Agreement, last_words
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StreamDecision

S = 1_000_000_000
CONFIG = preset("lidar_indoor")
COVARIANCE = np.diag([0.03**2] * 3 + [np.radians(0.1) ** 2] * 3)
LENGTH = 40  # steps of a metre out, and as many back


def pose(x: float, y: float = 0.0, yaw_deg: float = 0.0) -> np.ndarray:
    return se3.make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), (x, y, 0.0))


def way(drift: np.ndarray | None = None) -> tuple[np.ndarray, Trajectory]:
    """There and back along a corridor: true poses (N, 4, 4), and odometry that adds `drift` at each step."""
    truth = np.array([pose(k) for k in range(LENGTH)] + [pose(LENGTH - k, 1.0, 180.0) for k in range(LENGTH)])
    steps = se3.invert(truth[:-1]) @ truth[1:]
    odometry = [truth[0]]
    for step in steps:
        odometry.append(odometry[-1] @ step @ (np.eye(4) if drift is None else drift))
    return truth, Trajectory(S * np.arange(1, len(truth) + 1), np.array(odometry))


TRUTH, ODOMETRY = way()


def loop(
    source: int, target: int, T: np.ndarray | None = None, accepted: bool = True, probability: float = 0.95,
    odometry: Trajectory | None = ODOMETRY,
) -> StreamDecision:  # fmt: skip
    """A loop at the true pose, or at T."""
    T = se3.invert(TRUTH[target]) @ TRUTH[source] if T is None else T
    result = RegistrationResult(
        Verdict.ACCEPTED if accepted else Verdict.UNDECIDED,
        Reason.OK if accepted else Reason.INSUFFICIENT_EVIDENCE,
        "svc", T if accepted else None, T, COVARIANCE if accepted else None, probability, detail="of the pair",
    )  # fmt: skip
    ends = (None, None) if odometry is None else (odometry.poses[source], odometry.poses[target])
    return StreamDecision(
        result, (source + 1) * S, (target + 1) * S, "lidar", "lidar", ends[0], "place", None, ends[1]
    )


def right_loops(num: int = 8) -> list[StreamDecision]:
    return [loop(LENGTH + k, LENGTH - k) for k in range(3, 3 + 4 * num, 4)]


def wrong_pose(rng: np.random.Generator) -> np.ndarray:
    return pose(*rng.uniform(-10.0, 10.0, 2), rng.uniform(-180.0, 180.0))


def told_of(decisions: list[StreamDecision], odometry: Trajectory = ODOMETRY) -> list[StreamDecision]:
    agreement = Agreement(CONFIG)
    return [told for decision in decisions for told in agreement.add([decision], odometry)]


def accepted_pairs(told: list[StreamDecision]) -> set[tuple[int, int]]:
    return {(d.source_stamp_ns, d.target_stamp_ns) for d in last_words(told) if d.result.accepted}


def pairs(decisions: list[StreamDecision]) -> set[tuple[int, int]]:
    return {(d.source_stamp_ns, d.target_stamp_ns) for d in decisions}


def test_right_loops_stay_accepted_and_nothing_more_is_said() -> None:
    loops = right_loops()
    told = told_of(loops)
    assert len(told) == len(loops)
    for decision, given in zip(told, loops, strict=True):
        assert decision is given


@pytest.mark.parametrize("place", ["before", "between", "after"])
@pytest.mark.parametrize("seed", range(5))
def test_three_wrong_loops_that_agree_with_nothing_are_not_in_the_graph(seed: int, place: str) -> None:
    rng, right = np.random.default_rng(seed), right_loops()
    sources = {"before": (41, 42, 42), "between": (52, 57, 62), "after": (77, 78, 79)}[place]
    wrong = [loop(s, int(rng.integers(0, 25)), wrong_pose(rng), probability=0.99) for s in sources]
    told = told_of(sorted([*right, *wrong], key=lambda d: d.source_stamp_ns))
    assert accepted_pairs(told) == pairs(right)
    graph = build_pose_graph(ODOMETRY, last_words(told), CONFIG.covariance)
    assert len(graph.edges) == len(ODOMETRY) - 1 + len(right)


@pytest.mark.parametrize("seed", range(5))
def test_where_half_of_the_candidates_are_wrong_all_right_ones_stay(seed: int) -> None:
    rng, right = np.random.default_rng(seed), right_loops()
    wrong = [loop(int(d.source_stamp_ns // S) - 2, int(rng.integers(0, 25)), wrong_pose(rng)) for d in right]
    told = told_of(sorted([*right, *wrong], key=lambda d: d.source_stamp_ns))
    assert accepted_pairs(told) == pairs(right)


def test_a_wrong_one_that_was_accepted_alone_is_withdrawn_when_others_come() -> None:
    T_wrong = pose(-5.0, 1.0, 178.0)  # the right one is 8 m away: odometry may have drifted by so much
    wrong, right = loop(LENGTH + 10, LENGTH - 13, T_wrong), right_loops()[2:]
    told = told_of([wrong, *right])
    assert told[0] is wrong
    (change,) = (d for d in told if d.origin == "agreement" and pairs([d]) == pairs([wrong]))
    assert (change.result.verdict, change.result.reason) == (Verdict.UNDECIDED, Reason.UNCONFIRMED)
    assert change.result.T_target_source is None
    assert change.result.covariance is None
    np.testing.assert_array_equal(change.result.best_candidate, T_wrong)
    assert "surer loops" in change.result.detail
    assert accepted_pairs(told) == pairs(right)


def test_one_accepted_loop_alone_stays_accepted() -> None:
    (right,) = right_loops(1)
    assert told_of([right]) == [right]


def test_an_accepted_loop_far_from_what_odometry_says_is_not_confirmed_until_another_agrees() -> None:
    slip = pose(0.0, 0.0, 170.0)  # the wheels lost the turn between 30 and 31
    odometry = Trajectory(ODOMETRY.stamps_ns, np.concatenate([ODOMETRY.poses[:31], ODOMETRY.poses[30] @ slip @ (
        se3.invert(ODOMETRY.poses[30]) @ ODOMETRY.poses[31:])]))  # fmt: skip
    first, second = loop(41, 15, odometry=odometry), loop(46, 20, odometry=odometry)
    told = told_of([first, second], odometry)
    assert (told[0].result.verdict, told[0].result.reason) == (Verdict.UNDECIDED, Reason.UNCONFIRMED)
    assert "odometry" in told[0].result.detail
    assert [d.origin for d in told[1:]] == ["place", "agreement"]
    assert accepted_pairs(told) == pairs([first, second])
    np.testing.assert_array_equal(told[2].result.T_target_source, first.result.T_target_source)
    np.testing.assert_array_equal(told[2].result.covariance, first.result.covariance)


def test_an_undecided_loop_that_independent_ones_confirm_becomes_accepted() -> None:
    undecided, right = loop(LENGTH + 13, LENGTH - 13, accepted=False, probability=0.3), right_loops(6)
    told = told_of([undecided, *right])
    assert told[0] is undecided
    (change,) = (d for d in told if d.origin == "agreement")
    assert pairs([change]) == pairs([undecided])
    assert change.result.accepted
    assert change.result.reason is Reason.OK
    assert change.result.covariance is not None
    assert "independent loops" in change.result.detail


def test_an_improbable_one_needs_more_than_one_that_agrees() -> None:
    undecided = loop(LENGTH + 13, LENGTH - 13, accepted=False, probability=0.05)
    right = [loop(LENGTH + k, LENGTH - k) for k in (5, 9, 17, 21)]
    assert accepted_pairs(told_of([undecided, right[1]])) == pairs([right[1]])
    assert pairs([undecided]) <= accepted_pairs(told_of([undecided, *right]))


def alike(source: int, target: int, off: tuple[float, float], accepted: bool, probability: float) -> StreamDecision:
    """A loop in a place that looks like the right one, `off` [m] from it in the target's frame."""
    return loop(source, target, pose(*off) @ se3.invert(TRUTH[target]) @ TRUTH[source], accepted, probability)


@pytest.mark.parametrize("probability", [0.3, 0.5, 0.8])
def test_a_loop_that_is_withdrawn_confirms_no_other(probability: float) -> None:
    near = LENGTH + 3, LENGTH - 3
    wrong = alike(*near, (4.0, 0.0), True, 0.87)  # odometry contradicts it
    neighbour = alike(near[0] + 4, near[1] - 4, (4.0, 0.0), False, probability)
    assert accepted_pairs(told_of([wrong, neighbour])) == set()
    assert accepted_pairs(told_of([neighbour, wrong])) == set()


def test_loops_left_undecided_do_not_speak_for_one_that_odometry_contradicts() -> None:
    family = [alike(LENGTH + k, LENGTH - k, (6.0, 0.0), k == 3, 0.87 if k == 3 else 0.5) for k in (3, 7, 11)]
    assert accepted_pairs(told_of(family)) == set()


@pytest.mark.parametrize("num_right", [4, 8, 12])
def test_a_place_alike_that_was_accepted_once_lifts_no_neighbour_beside_right_loops(num_right: int) -> None:
    rng = np.random.default_rng(num_right)
    for _ in range(20):
        right = [loop(LENGTH + k, LENGTH - k) for k in rng.choice(np.arange(3, 36), num_right, replace=False)]
        first = int(rng.integers(8, 33))
        angle, far_m = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 8.0)
        off = (far_m * np.cos(angle), far_m * np.sin(angle))
        family = [
            alike(LENGTH + k, LENGTH - k - 1, off, k == first, 0.9 if k == first else 0.4)
            for k in (first, first - 6, first + 5)
        ]
        assert accepted_pairs(told_of([family[0], *right, *family[1:]])) & pairs(family[1:]) == set()


@pytest.mark.parametrize("name", ["lidar_indoor", "lidar_outdoor"])
@pytest.mark.parametrize("apart", [2, 4, 8])
@pytest.mark.parametrize("slid_m", [1.0, 1.5, 2.0])
def test_what_may_have_slid_along_an_open_direction_is_not_accepted(name: str, apart: int, slid_m: float) -> None:
    right = [loop(LENGTH + 15 + k, LENGTH - 15 - k) for k in (-apart, apart)]
    slid = alike(LENGTH + 15, LENGTH - 15, (slid_m, 0.0), False, 0.6)
    agreement = Agreement(preset(name))
    told = [t for decision in (*right, slid) for t in agreement.add([decision], ODOMETRY)]
    assert accepted_pairs(told) == pairs(right)


def test_the_covariance_of_what_others_confirm_covers_its_error() -> None:
    for off_m in (0.0, 0.2, 0.35):
        undecided = alike(LENGTH + 15, LENGTH - 15, (off_m, 0.0), False, 0.3)
        right = [loop(LENGTH + k, LENGTH - k) for k in (3, 7, 11, 19, 23, 27)]
        told = last_words(told_of([*right, undecided]))
        (found,) = (d.result for d in told if pairs([d]) == pairs([undecided]))
        assert found.accepted
        assert found.covariance is not None
        assert off_m <= np.sqrt(found.covariance[0, 0])


def test_two_independent_loops_lift_an_improbable_one_and_one_does_not() -> None:
    undecided, near = loop(LENGTH + 15, LENGTH - 15, accepted=False, probability=0.4), (LENGTH + 11, LENGTH - 11)
    outdoor = preset("lidar_outdoor")
    for others, is_lifted in ((1, False), (2, True)):
        right = [loop(*near), loop(LENGTH + 19, LENGTH - 19)][:others]
        agreement = Agreement(outdoor)
        told = [t for decision in (undecided, *right) for t in agreement.add([decision], ODOMETRY)]
        assert (pairs([undecided]) <= accepted_pairs(told)) == is_lifted


def test_what_others_confirmed_stays_when_those_are_too_old_to_be_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agreement_module, "_MAX_LOOPS", 4)
    first = [loop(LENGTH + k, LENGTH - k) for k in (3, 11)]
    lifted = loop(LENGTH + 7, LENGTH - 7, accepted=False, probability=0.5)
    later = [loop(LENGTH + k, LENGTH - k) for k in (28, 31, 34, 37)]
    agreement = Agreement(preset("lidar_outdoor"))
    told = [t for decision in (*first, lifted, *later) for t in agreement.add([decision], ODOMETRY)]
    assert accepted_pairs(told) == pairs([*first, lifted, *later])
    assert len(told) == len(first) + 2 + len(later)


def test_neighbours_of_one_place_are_one_piece_of_evidence() -> None:
    crowd = [loop(LENGTH + 20 + k, LENGTH - 20 - k, accepted=False, probability=0.5) for k in range(4)]
    assert accepted_pairs(told_of(crowd)) == set()


def test_odometry_over_a_short_way_makes_a_likely_loop_accepted_where_it_says_the_same() -> None:
    likely = loop(30, 10, accepted=False, probability=0.6)
    told = told_of([likely])
    assert [d.origin for d in told] == ["place", "agreement"]
    assert (told[1].result.verdict, told[1].result.reason) == (Verdict.ACCEPTED, Reason.OK)
    assert told[1].result.detail.startswith("confirmed by odometry")
    np.testing.assert_array_equal(told[1].result.T_target_source, likely.result.best_candidate)


@pytest.mark.parametrize("how", ["far", "unlikely", "elsewhere", "against surer loops"])
def test_odometry_alone_makes_no_other_loop_accepted(how: str) -> None:
    T_elsewhere = se3.invert(TRUTH[10]) @ TRUTH[30] @ pose(0.6)
    this = {
        "far": loop(36, 10, accepted=False, probability=0.6),
        "unlikely": loop(30, 10, accepted=False, probability=0.45),
        "elsewhere": loop(30, 10, T_elsewhere, accepted=False, probability=0.6),
        "against surer loops": loop(30, 10, accepted=False, probability=0.6),
    }[how]
    surer = [loop(30 + k, 11 + k, se3.invert(TRUTH[11 + k]) @ TRUTH[30 + k] @ pose(-3.0)) for k in (0, 4, 8)]
    told = told_of([*(surer if how == "against surer loops" else []), this])
    assert pairs([this]).isdisjoint(accepted_pairs(told))


def test_an_undecided_one_that_agrees_with_nothing_is_unconfirmed() -> None:
    stray = loop(LENGTH + 1, LENGTH - 2, pose(8.0, -3.0, 90.0), accepted=False, probability=0.6)
    (told,) = told_of([stray])
    assert (told.result.verdict, told.result.reason) == (Verdict.UNDECIDED, Reason.UNCONFIRMED)
    assert told.result.detail.endswith("agrees with it: insufficient_evidence: of the pair")


def test_what_is_rejected_is_never_lifted() -> None:
    T = se3.invert(TRUTH[LENGTH - 13]) @ TRUTH[LENGTH + 13]
    refused = RegistrationResult(Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, "svc", best_candidate=T, probability=0.1)
    rejected = StreamDecision(
        refused, (LENGTH + 14) * S, (LENGTH - 12) * S, "lidar", "lidar", TRUTH[LENGTH + 13], "place", None,
        TRUTH[LENGTH - 13],
    )  # fmt: skip
    assert told_of([rejected, *right_loops()])[0] is rejected


def test_without_odometry_nothing_changes() -> None:
    rng = np.random.default_rng(0)
    loops = [loop(50 + k, k, wrong_pose(rng), odometry=None) for k in range(5)]
    assert told_of(loops) == loops


def test_drifting_odometry_leaves_right_loops_accepted() -> None:
    drift = pose(0.03, 0.01, 0.7)
    _, odometry = way(drift)
    loops = [loop(LENGTH + k, LENGTH - k, odometry=odometry) for k in range(3, 36, 4)]
    assert accepted_pairs(told_of(loops, odometry)) == pairs(loops)


def test_the_same_in_one_go_or_one_by_one() -> None:
    rng, right = np.random.default_rng(1), right_loops()
    loops = [d for k, r in enumerate(right) for d in (r, loop(r.source_stamp_ns // S, 3 * k, wrong_pose(rng)))]

    def lines(told: list[StreamDecision]) -> list[str]:
        return [json.dumps(result_to_json(d.result, origin=d.origin, source=d.source_stamp_ns)) for d in told]

    assert lines(Agreement(CONFIG).add(loops, ODOMETRY)) == lines(told_of(loops))


def test_after_a_reset_nothing_of_before_counts() -> None:
    agreement, (right,) = Agreement(CONFIG), right_loops(1)
    agreement.add(right_loops(6), ODOMETRY)
    agreement.reset()
    undecided = loop(LENGTH + 13, LENGTH - 13, accepted=False, probability=0.3)
    assert agreement.add([undecided, right], ODOMETRY) == told_of([undecided, right])


def test_how_far_odometry_is_believed_is_configured() -> None:
    careful = with_values(CONFIG, {"agreement.drift_ratio": 0.01, "agreement.drift_deg_per_metre": 0.05})
    off = loop(LENGTH + 5, LENGTH - 5, pose(3.0, 1.0, 180.0))  # 7 m from where odometry has it after 10 m
    assert Agreement(CONFIG).add([off], ODOMETRY)[0].result.accepted
    assert not Agreement(careful).add([off], ODOMETRY)[0].result.accepted
