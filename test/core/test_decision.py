"""Every piece of evidence ends in one verdict with one reason, and clear cases end where they must."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from svc_ros.core import decision
from svc_ros.core.config import PRESETS, DecisionConfig, preset
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence

CONFIG = DecisionConfig(
    offset=0.0, denied_weight=1.0, wide_denied_weight=1.0, structure_weight=2.0, min_probability=0.5,
    min_oriented_overlap=0.1, min_constraint=0.01, max_opposed_per_overlap=0.8, max_free_blocked_per_overlap=0.15,
    min_free=100, firm_structure=0.2, rival_odds=4.0,
)  # fmt: skip
NONE = np.zeros(0, np.int64)


def surface(denied: float, wide: float) -> SeenSurface:
    """1000 points that the other sensor saw, a share of them denied, of which a share counts by its clusters."""
    num = round(1000 * denied)
    return SeenSurface(1000, 1000 - num, np.arange(num), wide * num, 0, 0)


def evidence(
    denied: float = 0.0, overlap: float = 0.9, oriented: float | None = None, opposed: float = 0.0, other: float = 0.0,
    wide: float = 1.0, weakest: float = 0.25, constraint: float = 0.3, filled: float = 0.0, num_free: int = 1000,
) -> SightViewEvidence:  # fmt: skip
    """Shares as given: denied of the source, `other` of the target; filled free space of the target's sensor."""
    lines = SightLines(1000, 1000, NONE, NONE, num_free, round(filled * num_free)), SightLines(1000, 1000, NONE, NONE)
    return SightViewEvidence(
        *lines, overlap, overlap if oriented is None else oriented, opposed, constraint, weakest, 1.0,
        surface(denied, wide), surface(other, wide),
    )  # fmt: skip


def decide(case: SightViewEvidence, **borders: float) -> decision.Decision:
    return decision.decide(case, dataclasses.replace(CONFIG, **borders))


def ends_in(case: SightViewEvidence, **borders: float) -> tuple[Verdict, Reason]:
    decided = decide(case, **borders)
    assert decided.detail
    return decided.verdict, decided.reason


ACCEPTED = (Verdict.ACCEPTED, Reason.OK)
TOO_LITTLE = (Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE)
CONTRADICTED = (Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
NO_OVERLAP = (Verdict.REJECTED, Reason.LOW_OVERLAP)


# Clear cases


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(
    ("case", "verdict"),
    [
        (evidence(), Verdict.ACCEPTED),
        (evidence(overlap=0.0), Verdict.REJECTED),
        (evidence(denied=0.8), Verdict.REJECTED),
        (evidence(other=0.8), Verdict.REJECTED),
        (evidence(overlap=0.9, oriented=0.0, opposed=0.9), Verdict.REJECTED),
        (evidence(filled=0.8), Verdict.REJECTED),
    ],
    ids=["clear", "no_contact", "source_denied", "target_denied", "inside_out", "filled"],
)
def test_clear_cases(name, case, verdict):
    decided = decision.decide(case, preset(name).decision)
    assert decided.verdict is verdict
    assert (decided.reason is Reason.OK) is (verdict is Verdict.ACCEPTED)
    assert decided.detail


def test_every_evidence_has_an_answer():
    shares = (0.0, 0.01, 0.1, 0.3, 1.0)
    for denied, other, oriented, opposed, weakest in itertools.product(shares, repeat=5):
        case = evidence(denied, 1.0, oriented, opposed, other, weakest=weakest / 3, filled=opposed)
        for config in (CONFIG, DecisionConfig()):
            decided = decision.decide(case, config)
            assert 0.0 <= decided.probability <= 1.0
            assert (decided.verdict is Verdict.ACCEPTED) is (decided.reason is Reason.OK)


def test_of_what_nothing_was_seen_nothing_is_accepted():
    """No sensor looked where the other scan's surface stands, or no range image was made."""
    unseen = SeenSurface(1000, 0, NONE, 0.0, 0, 1000)
    blind = dataclasses.replace(evidence(), source_surface=unseen, target_surface=unseen)
    nothing = SightViewEvidence(*[SightLines(0, 0, NONE, NONE)] * 2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for case, config in itertools.product((blind, nothing), (CONFIG, DecisionConfig())):
        assert (case.denied_ratio, case.wide_denied_ratio) == (0.0, 0.0)
        assert decision.decide(case, config).verdict is not Verdict.ACCEPTED


@pytest.mark.parametrize("share", ["denied", "other", "opposed", "filled"])
def test_more_contradiction_never_helps(share):
    decided = [decide(evidence(**{share: value})) for value in np.linspace(0, 1, 101)]
    verdicts = [one.verdict is Verdict.ACCEPTED for one in decided]
    assert verdicts[0]
    assert not verdicts[-1]
    assert verdicts == sorted(verdicts, reverse=True)
    assert (np.diff([one.probability for one in decided]) <= 1e-12).all()


def test_more_structure_never_hurts():
    margins = [decision.measure_margins(evidence(denied=0.1, weakest=w), CONFIG).seen for w in np.linspace(0, 0.33, 50)]
    assert (np.diff(margins) > 0).all()
    assert margins[0] < 0 < margins[-1]


def test_contact_is_good_and_denied_surface_is_bad_for_the_score():
    assert decision.score(evidence(overlap=0.5)) > decision.score(evidence(overlap=0.3))
    assert decision.score(evidence(denied=0.1)) < decision.score(evidence())
    assert decision.score(evidence(other=0.1)) == pytest.approx(decision.score(evidence(denied=0.1)))
    nothing = SightViewEvidence(*[SightLines(0, 0, NONE, NONE)] * 2, 0.4, 0.3, 0.0)
    assert decision.score(nothing) == 0.3


# Margins


@pytest.mark.parametrize(
    ("denied", "other", "wide", "weakest"),
    [(0.0, 0.0, 1.0, 0.3), (0.01, 0.03, 0.5, 0.2), (0.2, 0.0, 0.1, 0.1), (0.0, 0.4, 0.0, 0.0), (1.0, 1.0, 1.0, 0.3)],
)
def test_the_margin_of_denied_surface_is_the_weighed_sum(denied, other, wide, weakest):
    weights = {"offset": -1.5, "denied_weight": 0.7, "wide_denied_weight": 1.1, "structure_weight": 3.0}
    case = evidence(denied, other=other, wide=wide, weakest=weakest)
    num = 1000 * (denied + other)
    confirmed = 2000 - num
    stray, least = decision._STRAY, decision._LEAST_DENIED
    plain, by_clusters = (math.log((d + stray) / (d + confirmed + stray) + least) for d in (num, wide * num))
    structure = math.log(weakest + decision._LEAST_STRUCTURE)
    expected = -1.5 - 0.7 * plain - 1.1 * by_clusters + 3.0 * structure
    assert decision.describe(case) == pytest.approx((plain, by_clusters, structure))
    config = dataclasses.replace(CONFIG, **weights)
    assert decision.measure_margins(case, config).seen == pytest.approx(expected)


def test_the_weights_act():
    case = evidence(denied=0.05, other=0.02, wide=0.3)
    plain, wide, structure = decision.describe(case)
    before = decision.measure_margins(case, CONFIG)
    for name, slope in (
        ("offset", 1.0), ("denied_weight", -plain), ("wide_denied_weight", -wide), ("structure_weight", structure)
    ):  # fmt: skip
        config = dataclasses.replace(CONFIG, **{name: getattr(CONFIG, name) + 0.25})
        after = decision.measure_margins(case, config)
        assert after.seen - before.seen == pytest.approx(0.25 * slope)
        assert (after.free, after.same_side, after.overlap) == (before.free, before.same_side, before.overlap)


def test_denied_surface_that_is_scattered_or_small_weighs_less_than_a_wide_wall():
    """What moved, edges and mixed pixels lie in small clusters; a wall in the wrong place is a wide one."""
    for denied in (0.02, 0.1, 0.3):
        small, wide = (
            decision.measure_margins(evidence(denied=denied, other=denied, wide=w), CONFIG).seen for w in (0.1, 1.0)
        )
        assert small > wide
    assert ends_in(evidence(denied=0.3, other=0.3, wide=0.05)) == ACCEPTED
    assert ends_in(evidence(denied=0.3, other=0.3, wide=1.0)) == CONTRADICTED


def test_a_handful_of_denied_points_says_little_where_little_is_confirmed():
    """Ten points are a tenth of a hundred, a few of which no scan is free of."""
    few = SeenSurface(1000, 45, np.arange(5), 5.0, 0, 0)
    case = dataclasses.replace(evidence(), source_surface=few, target_surface=few)
    none = dataclasses.replace(few, num_confirmed=50, denied_idx=NONE, wide_denied=0.0)
    without = dataclasses.replace(case, source_surface=none, target_surface=none)
    margins = [decision.measure_margins(e, CONFIG).seen for e in (case, without)]
    assert 0 < margins[1] - margins[0] < 2.0 * math.log(1.0 + 10 / decision._STRAY)


def test_margins_are_zero_on_the_borders_and_positive_on_the_good_side():
    agreeing, floor = 0.4, 0.02
    for factor, good in ((0.9, True), (1.1, False)):
        opposed = factor * CONFIG.max_opposed_per_overlap * agreeing
        filled = factor * CONFIG.max_free_blocked_per_overlap * agreeing
        case = evidence(overlap=agreeing, opposed=opposed, filled=filled)
        margins = decision.measure_margins(case, CONFIG)
        assert margins.same_side == pytest.approx(-2.0 * math.log(factor), abs=floor)
        assert margins.free == pytest.approx(-2.0 * math.log(factor), abs=2 * floor)
        assert (margins.same_side > 0, margins.free > 0) == (good, good)
    for factor in (0.8, 1.25):
        little = evidence(overlap=factor * CONFIG.min_oriented_overlap)
        one_way = evidence(constraint=factor * CONFIG.min_constraint)
        for case in (little, one_way):
            margins = decision.measure_margins(case, CONFIG)
            assert margins.overlap == pytest.approx(2.0 * math.log(factor))
            assert margins.smallest <= margins.overlap


def test_free_space_that_nobody_tells_is_no_margin():
    for num_free in (0, CONFIG.min_free - 1):
        assert decision.measure_margins(evidence(filled=1.0, num_free=num_free), CONFIG).free == math.inf
    assert decision.measure_margins(evidence(filled=1.0, num_free=CONFIG.min_free), CONFIG).free < 0


# Borders and paths


@pytest.mark.parametrize(
    ("border", "strict", "case", "end"),
    [
        ("min_oriented_overlap", 0.3, evidence(overlap=0.25), TOO_LITTLE),
        ("min_oriented_overlap", 0.8, evidence(overlap=0.25), NO_OVERLAP),
        ("min_constraint", 0.1, evidence(constraint=0.08), TOO_LITTLE),
        ("min_constraint", 0.9, evidence(constraint=0.08), NO_OVERLAP),
        ("max_opposed_per_overlap", 0.05, evidence(opposed=0.2), CONTRADICTED),
        ("max_free_blocked_per_overlap", 0.01, evidence(filled=0.05), CONTRADICTED),
        ("min_free", 50, evidence(filled=1.0, num_free=60), CONTRADICTED),
        ("offset", -20.0, evidence(), CONTRADICTED),
        ("denied_weight", 0.0, evidence(denied=0.12, other=0.12), CONTRADICTED),
        ("wide_denied_weight", 0.0, evidence(denied=0.12, other=0.12), CONTRADICTED),
        ("structure_weight", 20.0, evidence(), CONTRADICTED),
        ("min_probability", 1.0, evidence(denied=0.05), TOO_LITTLE),
    ],
)
def test_every_border_acts(border, strict, case, end):
    assert ends_in(case) == ACCEPTED
    assert ends_in(case, **{border: strict}) == end


def test_what_is_denied_is_said_in_the_detail():
    assert "denied surface 0.400" in decide(evidence(denied=0.4, other=0.4)).detail
    assert "both sides 0.900" in decide(evidence(opposed=0.9, overlap=0.4)).detail
    assert "free space 0.800" in decide(evidence(filled=0.8)).detail
    assert "free space" not in decide(evidence(denied=0.8)).detail


def test_surfaces_that_leave_a_way_open_are_undecided_unless_they_are_denied():
    """Along a corridor: too little is denied to reject, too much to tell the pose from a slip."""
    slight, much = evidence(denied=0.12, other=0.12, weakest=0.04), evidence(denied=0.4, other=0.4, weakest=0.04)
    assert decision.measure_margins(slight, CONFIG).seen < 0
    assert ends_in(slight) == TOO_LITTLE
    assert "resist" in decide(slight).detail
    assert ends_in(much) == CONTRADICTED
    assert ends_in(dataclasses.replace(slight, weakest_constraint=0.3)) == ACCEPTED
    assert ends_in(dataclasses.replace(slight, opposed_ratio=0.9)) == CONTRADICTED
    filled = dataclasses.replace(slight, source_in_target=evidence(filled=0.9).source_in_target)
    assert ends_in(filled) == CONTRADICTED


def test_firm_structure_parts_rejected_from_undecided():
    case = evidence(denied=0.12, other=0.12, weakest=0.04)
    for firm, end in ((0.0, CONTRADICTED), (0.04, CONTRADICTED), (0.2, TOO_LITTLE), (1.0, TOO_LITTLE)):
        assert ends_in(case, firm_structure=firm) == end
    firmly_held = evidence(denied=0.5, other=0.5, weakest=0.3)  # more than firm: its own structure counts
    for firm in (0.0, 0.2, 0.25):
        assert ends_in(firmly_held, firm_structure=firm) == CONTRADICTED


def test_firm_structure_never_makes_an_acceptance():
    for denied, weakest, firm in itertools.product((0.0, 0.05, 0.12, 0.3), (0.0, 0.02, 0.05, 0.3), (0.0, 0.2, 1.0)):
        case = evidence(denied, other=denied, weakest=weakest)
        accepted = decision.measure_margins(case, CONFIG).smallest > 0
        assert (decide(case, firm_structure=firm).verdict is Verdict.ACCEPTED) is accepted


def test_little_overlap_without_contradiction_is_undecided_and_none_is_rejected():
    near, far = (evidence(overlap=f * CONFIG.min_oriented_overlap) for f in (0.9, 0.1))
    assert ends_in(near) == TOO_LITTLE
    assert ends_in(far) == NO_OVERLAP
    assert "no contradiction" in decide(near).detail
    assert ends_in(evidence(overlap=0.51 * CONFIG.min_oriented_overlap)) == TOO_LITTLE
    assert ends_in(evidence(overlap=0.49 * CONFIG.min_oriented_overlap)) == NO_OVERLAP


def test_little_overlap_with_a_contradiction_is_rejected():
    little = 0.6 * CONFIG.min_oriented_overlap
    slightly = CONFIG.max_opposed_per_overlap * little
    case = evidence(overlap=little, opposed=1.1 * slightly)
    margins = decision.measure_margins(case, CONFIG)
    assert margins.overlap < margins.same_side < 0  # the overlap is what is worst
    assert ends_in(case) == NO_OVERLAP


def test_the_asked_for_probability_is_the_least_that_is_accepted():
    case = evidence(denied=0.1, other=0.1)
    probability = decide(case).probability
    assert 0.5 < probability < 0.99
    assert ends_in(case, min_probability=probability) == ACCEPTED
    assert ends_in(case, min_probability=probability + 1e-6) == TOO_LITTLE
    assert decide(case, min_probability=0.99).probability == probability
    assert "asked for" in decide(case, min_probability=0.99).detail
    assert ends_in(evidence(denied=0.9, other=0.9), min_probability=0.99) == CONTRADICTED  # a no stays one


@pytest.mark.parametrize("config", [CONFIG, *(preset(name).decision for name in PRESETS)])
def test_probability_is_a_half_at_the_border_and_follows_the_margin(config):
    config = dataclasses.replace(config, min_probability=0.5)
    cases = [evidence(denied=b, overlap=o, weakest=w)
             for b in np.linspace(0, 1.0, 21) for o in (0.05, 0.3, 0.9) for w in (0.02, 0.1, 0.3)]  # fmt: skip
    margins = np.array([decision.measure_margins(case, config).smallest for case in cases])
    decided = [decision.decide(case, config) for case in cases]
    assert (margins > 0).any()
    assert (margins < 0).any()
    order = np.argsort(margins)
    assert (np.diff(np.array([d.probability for d in decided])[order]) >= 0).all()
    for margin, one in zip(margins, decided, strict=True):
        assert one.probability == pytest.approx(1.0 / (1.0 + math.exp(-margin)))
        assert (one.probability > 0.5) is bool(margin > 0)
        assert (one.verdict is Verdict.ACCEPTED) is bool(margin > 0)


# Doubts


NO_DOUBTS = decision.Doubts([], [], [])
RIGHT = evidence(denied=0.05, overlap=0.8)


def doubt(case: SightViewEvidence, config: DecisionConfig = CONFIG, **doubts: list[SightViewEvidence]):
    accepted = decision.decide(case, config)
    assert accepted.verdict is Verdict.ACCEPTED
    return decision.doubt(accepted, case, dataclasses.replace(NO_DOUBTS, **doubts), config)


@pytest.mark.parametrize("kind", ["others", "far_slips"])
def test_a_different_pose_that_is_as_good_takes_the_acceptance_back(kind):
    for rival, verdict in (
        (evidence(denied=0.05, overlap=0.79), Verdict.UNDECIDED),
        (evidence(denied=0.06, overlap=0.5), Verdict.UNDECIDED),  # it overlaps less, but is as likely
        (evidence(denied=0.4, overlap=0.79), Verdict.ACCEPTED),  # contradicted
        (evidence(denied=0.05, overlap=0.05), Verdict.ACCEPTED),  # hardly any contact
    ):
        doubted = doubt(RIGHT, **{kind: [evidence(denied=0.9), rival]})
        assert doubted.verdict is verdict
        assert doubted.reason is (Reason.AMBIGUOUS if verdict is Verdict.UNDECIDED else Reason.OK)
        assert (doubted.probability < 0.5) is (verdict is Verdict.UNDECIDED)
        assert doubted.detail


@pytest.mark.parametrize("kind", ["others", "far_slips"])
def test_a_rival_is_as_good_if_its_odds_are_less_by_no_more_than_asked(kind):
    """Of another pose by all that is known of it; of a slip by what is denied."""
    rival = evidence(denied=0.15, overlap=0.7)
    margins = [decision.measure_margins(e, CONFIG) for e in (RIGHT, rival)]
    right, other = (m.smallest if kind == "others" else m.seen for m in margins)
    ratio = math.exp(right - other)
    assert ratio > 2.0
    for factor, reason in ((0.99, Reason.OK), (1.01, Reason.AMBIGUOUS)):
        config = dataclasses.replace(CONFIG, rival_odds=factor * ratio)
        assert doubt(RIGHT, config, **{kind: [rival]}).reason is reason


def test_a_slip_is_held_against_the_structure_of_the_pose():
    """Along a way that surfaces leave open nothing is denied; what the slip itself is held by does not matter."""
    for weakest in (0.0, 0.1, 0.33):
        slip = dataclasses.replace(RIGHT, oriented_overlap_ratio=0.7, weakest_constraint=weakest)
        assert doubt(RIGHT, far_slips=[slip]).reason is Reason.AMBIGUOUS


@pytest.mark.parametrize(
    "slip",
    [
        evidence(denied=0.05, overlap=0.39), evidence(denied=0.05, overlap=0.79, opposed=0.8),
        evidence(denied=0.05, overlap=0.79, filled=0.5),
        evidence(denied=0.05, overlap=0.79, constraint=0.9 * CONFIG.min_constraint),
    ],
    ids=["less_than_half_of_the_overlap", "opposed", "fills_free_space", "agrees_one_way"],
)  # fmt: skip
def test_a_slip_that_is_told_by_something_else_casts_no_doubt(slip):
    assert doubt(RIGHT, far_slips=[slip]).reason is Reason.OK
    assert doubt(RIGHT, far_slips=[slip, evidence(denied=0.05, overlap=0.41)]).reason is Reason.AMBIGUOUS


def test_a_rival_may_itself_be_just_beyond_a_border():
    judged, rival = evidence(denied=0.22, other=0.22), evidence(denied=0.25, other=0.25)
    margins = [decision.measure_margins(e, CONFIG).smallest for e in (judged, rival)]
    assert margins[0] - math.log(CONFIG.rival_odds) < margins[1] < margins[0]
    shifted = dataclasses.replace(CONFIG, offset=-0.5 * sum(margins))  # the border lies between both
    assert decision.decide(rival, shifted).verdict is not Verdict.ACCEPTED
    assert doubt(judged, shifted, others=[rival]).reason is Reason.AMBIGUOUS


def test_near_slips_are_nearly_the_same_pose_and_doubt_only_by_looking_better():
    alike = evidence(denied=0.05, overlap=0.79)
    assert doubt(RIGHT, near_slips=[alike]).reason is Reason.OK
    assert doubt(RIGHT, near_slips=[evidence(denied=0.05, overlap=0.81)]).reason is Reason.AMBIGUOUS


@pytest.mark.parametrize("kind", ["far_slips", "near_slips"])
def test_a_slip_that_looks_better_takes_the_acceptance_back_even_if_it_is_far_less_likely(kind):
    better = evidence(denied=0.05, overlap=0.9, opposed=0.9)
    assert decision.measure_margins(better, CONFIG).smallest < 0
    assert decision.score(better) > decision.score(RIGHT)
    assert doubt(RIGHT, **{kind: [better]}).reason is Reason.AMBIGUOUS
    assert doubt(RIGHT, others=[better]).reason is Reason.OK  # of another hypothesis the odds tell


def test_doubt_never_turns_a_no_into_a_yes():
    for case in (evidence(denied=0.8), evidence(overlap=0.0), evidence(overlap=0.09)):
        decided = decision.decide(case, CONFIG)
        rivals = [evidence(), evidence(overlap=0.1), evidence(denied=0.9)]
        assert decision.doubt(decided, case, decision.Doubts(rivals, rivals, rivals), CONFIG) is decided
    accepted = decision.decide(RIGHT, CONFIG)
    assert decision.doubt(accepted, RIGHT, NO_DOUBTS, CONFIG) is accepted


def test_a_pose_that_refinement_left_is_rejected_and_says_how_far():
    decided = decision.moved_away(12.34, 5.67)
    assert (decided.verdict, decided.reason) == (Verdict.REJECTED, Reason.AMBIGUOUS)
    assert decided.probability < 0.5
    assert "12.34" in decided.detail
    assert "5.67" in decided.detail
