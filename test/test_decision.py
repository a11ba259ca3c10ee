"""Every piece of evidence ends in one verdict with one reason, and clear cases end where they must."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from svc_ros.core import decision
from svc_ros.core.config import PRESETS, DecisionConfig, preset
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.result import Reason, Verdict


def evidence(
    blocked: float = 0.0, overlap: float = 0.9, oriented: float | None = None, opposed: float = 0.0, other: float = 0.0
) -> SightViewEvidence:
    """1000 sight lines each way with shares as given."""
    lines = [SightLines(1000, 1000, *[np.arange(round(share * 1000))] * 2) for share in (blocked, other)]
    return SightViewEvidence(*lines, overlap, overlap if oriented is None else oriented, opposed)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(
    ("case", "verdict"),
    [
        (evidence(), Verdict.ACCEPTED),
        (evidence(overlap=0.0), Verdict.REJECTED),
        (evidence(blocked=0.8), Verdict.REJECTED),
        (evidence(other=0.8), Verdict.REJECTED),
        (evidence(overlap=0.9, oriented=0.0, opposed=0.9), Verdict.REJECTED),
    ],
    ids=["clear", "no_contact", "target_blocked", "source_blocked", "inside_out"],
)
def test_clear_cases(name, case, verdict):
    decided = decision.decide(case, preset(name).decision)
    assert decided.verdict is verdict
    assert (decided.reason is Reason.OK) is (verdict is Verdict.ACCEPTED)
    assert decided.detail


def test_every_evidence_has_an_answer():
    shares = (0.0, 0.01, 0.05, 0.1, 0.3, 0.6, 1.0)
    for blocked, other, oriented, opposed in itertools.product(shares, repeat=4):
        decided = decision.decide(evidence(blocked, 1.0, oriented, opposed, other), DecisionConfig())
        assert 0.0 <= decided.probability <= 1.0
        assert (decided.verdict is Verdict.ACCEPTED) is (decided.reason is Reason.OK)


@pytest.mark.parametrize("share", ["blocked", "other", "opposed"])
def test_more_contradiction_never_helps(share):
    verdicts = [
        decision.decide(evidence(**{share: value}), DecisionConfig()).verdict is Verdict.ACCEPTED
        for value in np.linspace(0, 1, 101)
    ]
    assert verdicts[0]
    assert verdicts == sorted(verdicts, reverse=True)


def test_contact_is_good_and_blocking_is_bad_for_the_score():
    assert decision.score(evidence(overlap=0.5)) > decision.score(evidence(overlap=0.3))
    assert decision.score(evidence(blocked=0.1)) < decision.score(evidence())
    assert decision.score(evidence(other=0.1)) < decision.score(evidence())


def test_margins_are_zero_on_the_borders_and_positive_on_the_good_side():
    config = DecisionConfig()
    agreeing = 0.4
    values = []
    for factor in (0.5, 1.0, 2.0):
        case = evidence(overlap=agreeing, opposed=factor * config.max_opposed_per_overlap * agreeing)
        values.append(decision.measure_margins(case, config).same_side)
    assert values[0] > 0 > values[2]
    assert values[1] == pytest.approx(0.0, abs=0.05)  # up to the floor of a thousandth
    low, high = (
        decision.measure_margins(evidence(overlap=f * config.min_oriented_overlap), config) for f in (0.9, 1.1)
    )
    assert low.overlap < 0 < high.overlap
    assert low.smallest <= low.overlap


def contact(blocked: int, observed: int, tight: float, overlap: float = 0.6) -> SightViewEvidence:
    """1000 lines each way, so many of them along unmatched surface, so many blocked all around."""
    lines = [SightLines(1000, observed, *[np.arange(blocked)] * 2) for _ in range(2)]
    return SightViewEvidence(*lines, overlap, overlap, 0.0, 0.3, 0.2, tight)


def test_the_margin_of_sight_lines_is_the_weighed_sum():
    config = DecisionConfig()
    for blocked, observed, tight in ((10, 60, 0.85), (30, 90, 0.7), (25, 100, 0.95), (4, 200, 0.6)):
        share, ratio = np.log((blocked / 1000 + 1e-3) / 0.6), np.log(max(blocked / observed, 0.01))
        expected = config.free_offset - (config.blocked_weight + config.scattered_weight) * share
        expected += -config.contradicted_weight * ratio + config.tight_weight * np.log(tight / (1 - tight))
        most = np.log(2.2 * config.max_scattered_per_overlap * 0.6 / (blocked / 1000 + 1e-3))
        margins = decision.measure_margins(contact(blocked, observed, tight), config)
        assert margins.free == pytest.approx(min(expected / config.sharpness, most))


def test_rooms_that_look_alike_are_not_accepted_where_traffic_is():
    """As simulated: equally many lines are blocked, but the walls of another room lie loosely on each other."""
    assert decision.decide(contact(blocked=40, observed=120, tight=0.95), DecisionConfig()).verdict is Verdict.ACCEPTED
    for tight in (0.25, 0.5, 0.75):
        assert decision.decide(contact(40, 120, tight), DecisionConfig()).verdict is not Verdict.ACCEPTED


def test_unmatched_surface_behind_what_was_seen_speaks_for_a_pose():
    """Of a right pose most of it lies there, hidden from the observer; of a wrong one half stands in the way."""
    behind, both = (contact(blocked=30, observed=observed, tight=0.8) for observed in (300, 60))
    assert decision.decide(behind, DecisionConfig()).verdict is Verdict.ACCEPTED
    assert decision.decide(both, DecisionConfig()).verdict is not Verdict.ACCEPTED


def test_no_contact_is_tight_enough_to_make_good_what_is_blocked_everywhere():
    for blocked in (150, 300, 900):
        assert decision.decide(contact(blocked, 1000, 1.0), DecisionConfig()).verdict is Verdict.REJECTED


def scatter(case: SightViewEvidence, num: int) -> SightViewEvidence:
    """The same evidence with `num` of the blocked lines outside the most blocked sectors, either way."""
    ways = (dataclasses.replace(way, num_scattered=min(num, way.num_blocked))
            for way in (case.source_in_target, case.target_in_source))  # fmt: skip
    return SightViewEvidence(*ways, case.overlap_ratio, case.oriented_overlap_ratio, case.opposed_ratio)


def test_blocks_in_a_few_sectors_weigh_less_than_blocks_all_around():
    """What one moving object hides lies in one direction; a wrong pose contradicts everywhere."""
    config = DecisionConfig()
    everywhere = contact(blocked=50, observed=140, tight=0.88)
    assert everywhere.source_in_target.num_scattered == everywhere.source_in_target.num_blocked
    ways = [dataclasses.replace(way, num_scattered=0) for way in (everywhere.source_in_target,) * 2]
    one_object = dataclasses.replace(everywhere, source_in_target=ways[0], target_in_source=ways[1])
    assert decision.decide(one_object, config).verdict is Verdict.ACCEPTED
    assert decision.decide(everywhere, config).verdict is not Verdict.ACCEPTED


@pytest.mark.parametrize("name", PRESETS)
def test_probability_is_a_half_at_the_border_and_follows_the_margin(name):
    config = preset(name).decision
    cases = [scatter(evidence(blocked=b, overlap=o), 0) for b in np.linspace(0, 0.2, 21) for o in (0.05, 0.3, 0.9)]
    margins = np.array([decision.measure_margins(case, config).smallest for case in cases])
    decided = [decision.decide(case, config) for case in cases]
    order = np.argsort(margins)
    assert (np.diff(np.array([d.probability for d in decided])[order]) >= 0).all()
    for margin, one in zip(margins, decided, strict=True):
        assert (one.probability > 0.5) is bool(margin > 0)
        assert one.verdict is Verdict.ACCEPTED or margin <= 0
        assert one.verdict is not Verdict.ACCEPTED or margin > 0


def test_little_overlap_without_contradiction_is_undecided_and_none_is_rejected():
    config = DecisionConfig()
    near, far = (evidence(overlap=f * config.min_oriented_overlap) for f in (0.9, 0.1))
    assert decision.decide(near, config).reason is Reason.INSUFFICIENT_EVIDENCE
    assert decision.decide(near, config).verdict is Verdict.UNDECIDED
    assert decision.decide(far, config).verdict is Verdict.REJECTED
    assert decision.decide(far, config).reason is Reason.LOW_OVERLAP


NO_DOUBTS = decision.Doubts([], [], [])
RIGHT = evidence(overlap=0.8)


@pytest.mark.parametrize("kind", ["others", "far_slips"])
def test_a_different_pose_that_is_as_good_takes_the_acceptance_back(kind):
    config = DecisionConfig()
    accepted = decision.decide(RIGHT, config)
    for rival, verdict in (
        (evidence(overlap=0.79), Verdict.UNDECIDED),
        (evidence(overlap=0.3), Verdict.ACCEPTED),  # free as well, but much worse
        (evidence(blocked=0.5, overlap=0.79), Verdict.ACCEPTED),  # contradicted
    ):
        doubted = decision.doubt(accepted, RIGHT, dataclasses.replace(NO_DOUBTS, **{kind: [rival]}), config)
        assert doubted.verdict is verdict
        assert doubted.reason is (Reason.AMBIGUOUS if verdict is Verdict.UNDECIDED else Reason.OK)
        assert (doubted.probability < 0.5) is (verdict is Verdict.UNDECIDED)
        assert doubted.detail


@pytest.mark.parametrize("kind", ["far_slips", "near_slips"])
def test_a_slip_that_looks_better_takes_the_acceptance_back_even_if_it_is_blocked(kind):
    worse = evidence(blocked=0.05, overlap=0.8)
    accepted = decision.decide(scatter(worse, 0), DecisionConfig())
    better = evidence(blocked=0.04, overlap=0.8)
    assert accepted.verdict is Verdict.ACCEPTED
    doubted = decision.doubt(accepted, worse, dataclasses.replace(NO_DOUBTS, **{kind: [better]}), DecisionConfig())
    assert (doubted.verdict, doubted.reason) == (Verdict.UNDECIDED, Reason.AMBIGUOUS)


def test_doubt_never_turns_a_no_into_a_yes():
    config = DecisionConfig()
    for case in (evidence(blocked=0.8), evidence(overlap=0.0), evidence(overlap=0.09)):
        decided = decision.decide(case, config)
        rivals = [evidence(), evidence(overlap=0.1), evidence(blocked=0.9)]
        assert decision.doubt(decided, case, decision.Doubts(rivals, rivals, rivals), config) is decided
    accepted = decision.decide(RIGHT, config)
    assert decision.doubt(accepted, RIGHT, NO_DOUBTS, config) is accepted


def test_a_pose_that_refinement_left_is_rejected_and_says_how_far():
    decided = decision.moved_away(12.34, 5.67)
    assert (decided.verdict, decided.reason) == (Verdict.REJECTED, Reason.AMBIGUOUS)
    assert decided.probability < 0.5
    assert "12.34" in decided.detail
    assert "5.67" in decided.detail
