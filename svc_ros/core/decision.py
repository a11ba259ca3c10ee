"""From evidence to a verdict. Every path ends in exactly one reason."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from svc_ros.core.decision_config import DecisionConfig
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.sight.evidence import SightViewEvidence

_STRAY = 3  # denied points that no scan is free of: with little confirmed surface they are a large share
_LEAST_DENIED = 2e-3  # less than that tells nothing any more
_LEAST_STRUCTURE = 0.03  # added to the resistance, in whose logarithm next to none is not far from none
_SLOPE = 2.0  # of log odds over the margins that are not fitted
_DENIED_WEIGHT = 1.5  # a denied point counts as much as this many agreeing ones
_KEPT_OVERLAP = 0.5  # of the pose's: a slip that loses more is told by that
_UNCERTAIN_SCORE, _UNCERTAIN_ODDS = 0.1, 3.0  # of a look with few points
_FLOOR = 1e-3  # smallest share that logarithms see


@dataclass(frozen=True)
class Decision:
    """The answer on one pose; probability in [0, 1] that the pose is right, at least one half where it is accepted."""

    verdict: Verdict
    reason: Reason
    probability: float
    detail: str


@dataclass(frozen=True)
class Margins:
    """How far the evidence lies on the good side of each border, as log odds; positive where it is kept.

    seen: denied surface against the structure of what agrees; free: filled free space (infinite where no sensor tells
    any); same_side: surfaces seen from both sides; overlap: agreeing surface, enough of it, facing more than one way.
    """

    seen: float
    free: float
    same_side: float
    overlap: float

    @property
    def smallest(self) -> float:
        """Positive where every border is kept."""
        return min(self.seen, self.free, self.same_side, self.overlap)


def score(evidence: SightViewEvidence) -> float:
    """How good a refined pose looks: what overlaps on the same side, less what is denied."""
    denied = sum(surface.num_denied / max(surface.num_points, 1) for surface in evidence.surfaces)
    return evidence.oriented_overlap_ratio - _DENIED_WEIGHT * denied


def measure_margins(evidence: SightViewEvidence, config: DecisionConfig) -> Margins:
    """Compare the evidence with the borders.

    What is denied is weighed together with the structure of the agreeing surface: a wrong pose finds agreement where
    surfaces face one or two ways, seldom all, so that a pose that is held firmly may be denied more, as in traffic.
    """
    return Margins(_weigh(describe(evidence), config), *_other_margins(evidence, config))


def _other_margins(evidence: SightViewEvidence, config: DecisionConfig) -> tuple[float, float, float]:
    """Those that are not fitted: free, same_side, overlap."""
    agreeing = max(evidence.oriented_overlap_ratio, _FLOOR)
    constraint = max(evidence.constraint_ratio, 0.1 * _FLOOR)
    opposed = math.log(config.max_opposed_per_overlap * agreeing / (evidence.opposed_ratio + _FLOOR))
    overlap = math.log(min(agreeing / config.min_oriented_overlap, constraint / config.min_constraint))
    return _SLOPE * _free_space_margin(evidence, config), _SLOPE * opposed, _SLOPE * overlap


def describe(evidence: SightViewEvidence) -> tuple[float, float, float]:
    """What is weighed: logarithms of the denied share, of the same by clusters, and of the weakest constraint."""
    seen = evidence.surfaces
    confirmed = sum(surface.num_confirmed for surface in seen)

    def share(denied: float) -> float:
        return math.log((denied + _STRAY) / (denied + confirmed + _STRAY) + _LEAST_DENIED)

    denied, wide = sum(s.num_denied for s in seen), sum(s.wide_denied for s in seen)
    return share(denied), share(wide), math.log(evidence.weakest_constraint + _LEAST_STRUCTURE)


def _weigh(described: tuple[float, float, float], config: DecisionConfig) -> float:
    """Log odds that the pose is right (logistic regression)."""
    denied, wide, structure = described
    return (
        config.offset - config.denied_weight * denied - config.wide_denied_weight * wide
        + config.structure_weight * structure
    )  # fmt: skip


def _free_space_margin(evidence: SightViewEvidence, config: DecisionConfig) -> float:
    """Infinite where neither sensor tells enough free directions, so that it can only speak against a pose."""
    largest = config.max_free_blocked_per_overlap * max(evidence.oriented_overlap_ratio, _FLOOR)
    told = [s for s in (evidence.source_in_target, evidence.target_in_source) if s.num_free >= config.min_free]
    return min((math.log(largest / (lines.free_blocked_ratio + _FLOOR)) for lines in told), default=math.inf)


def decide(evidence: SightViewEvidence, config: DecisionConfig) -> Decision:
    """Judge one refined pose by its evidence alone."""
    margins = measure_margins(evidence, config)
    probability = 1.0 / (1.0 + math.exp(min(-margins.smallest, 700.0)))
    seen = f"denied surface {evidence.denied_ratio:.3f}, oriented overlap {evidence.oriented_overlap_ratio:.3f}"
    if margins.smallest > 0:
        if probability < config.min_probability:
            why = f"probability {probability:.2f}, at least {config.min_probability:g} is asked for: {seen}"
            return Decision(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, probability, why)
        return Decision(Verdict.ACCEPTED, Reason.OK, probability, seen)
    if margins.overlap <= min(margins.seen, margins.free, margins.same_side):
        return _too_little_overlap(evidence, margins, probability, config)
    if min(margins.free, margins.same_side) > 0 and not _is_denied(evidence, config):
        detail = (
            f"surfaces that resist a shift by {evidence.weakest_constraint:.3f}, denied surface "
            f"{evidence.denied_ratio:.3f}: too little to tell the pose from others along the way that they leave open"
        )
        return Decision(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, probability, detail)
    return Decision(Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, probability, _contradictions(evidence))


def _is_denied(evidence: SightViewEvidence, config: DecisionConfig) -> bool:
    """Whether more is denied than of a pose that is held firmly: then no structure would make it right."""
    if not any(s.num_confirmed or s.num_denied for s in evidence.surfaces):
        return False  # nothing was seen, either way
    denied, wide, structure = describe(evidence)
    return _weigh((denied, wide, max(structure, math.log(config.firm_structure + _LEAST_STRUCTURE))), config) <= 0.0


def _contradictions(evidence: SightViewEvidence) -> str:
    ways = (evidence.source_in_target, evidence.target_in_source)
    free = max(lines.free_blocked_ratio for lines in ways)
    filled = f"filled free space {free:.3f}, " if free else ""
    return (
        f"{filled}denied surface {evidence.denied_ratio:.3f} (the other sensor looked through it), surfaces seen from "
        f"both sides {evidence.opposed_ratio:.3f}, oriented overlap {evidence.oriented_overlap_ratio:.3f}"
    )


def _too_little_overlap(
    evidence: SightViewEvidence, margins: Margins, probability: float, config: DecisionConfig
) -> Decision:
    """Nothing speaks against the pose but too little speaks for it: undecided near the border, rejected far from it."""
    detail = (
        f"oriented overlap {evidence.oriented_overlap_ratio:.3f} (at least {config.min_oriented_overlap:g}), "
        f"across directions {evidence.constraint_ratio:.4f} (at least {config.min_constraint:g})"
    )
    if min(margins.seen, margins.free, margins.same_side) > 0 and margins.overlap > _SLOPE * math.log(0.5):
        return Decision(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, probability, f"no contradiction, but {detail}")
    return Decision(Verdict.REJECTED, Reason.LOW_OVERLAP, probability, detail)


@dataclass(frozen=True)
class Doubts:
    """Evidence of poses that differ from the judged one.

    others: further hypotheses, each refined; far_slips: the pose shifted far along the directions that the surfaces
    hardly resist; near_slips: shifted half as far.
    """

    others: Sequence[SightViewEvidence]
    far_slips: Sequence[SightViewEvidence]
    near_slips: Sequence[SightViewEvidence]


def doubt(decided: Decision, evidence: SightViewEvidence, doubts: Doubts, config: DecisionConfig) -> Decision:
    """Withdraw an acceptance where a *different* pose is about as good.

    That is another refined pose whose odds are less by no more than `rival_odds`; a slip whose odds by what is denied
    alone are (the structure is the same), and that keeps half of the overlap; any slip that even looks better, which
    tells that refinement stopped short of it.
    """
    if decided.verdict is not Verdict.ACCEPTED:
        return decided
    near = math.log(config.rival_odds)
    least, best = measure_margins(evidence, config).smallest - near, score(evidence)
    rivals = [e for e in doubts.others if measure_margins(e, config).smallest > least]
    rivals += [e for e in doubts.far_slips if _is_no_worse(e, evidence, near, config)]
    rivals += [e for e in (*doubts.far_slips, *doubts.near_slips) if score(e) > best]
    return _ambiguous(decided, evidence, rivals[0]) if rivals else decided


def _is_no_worse(slip: SightViewEvidence, evidence: SightViewEvidence, near: float, config: DecisionConfig) -> bool:
    """Whether hardly more is denied of a slip than of the pose itself."""
    if slip.oriented_overlap_ratio < _KEPT_OVERLAP * evidence.oriented_overlap_ratio:
        return False
    return _lost_odds(slip, evidence, config) < near and min(*_other_margins(slip, config)) > 0.0


def _lost_odds(slip: SightViewEvidence, evidence: SightViewEvidence, config: DecisionConfig) -> float:
    """How much less likely, in log odds, a slip is by what is denied alone."""
    _, _, structure = describe(evidence)
    pose, slipped = (_weigh((*describe(e)[:2], structure), config) for e in (evidence, slip))
    return pose - slipped


def is_far_worse(slip: SightViewEvidence, evidence: SightViewEvidence, config: DecisionConfig) -> bool:
    """Whether a slip, looked at with few points, is so much worse that all of them could make it no rival.

    Few points make a share of next to nothing larger, by up to 2.4 in log odds, and scores uncertain by a few percent.
    """
    if score(slip) > score(evidence) - _UNCERTAIN_SCORE:
        return False
    lost_overlap = slip.oriented_overlap_ratio < (_KEPT_OVERLAP - 0.1) * evidence.oriented_overlap_ratio
    return lost_overlap or _lost_odds(slip, evidence, config) > math.log(config.rival_odds) + _UNCERTAIN_ODDS


def _ambiguous(decided: Decision, evidence: SightViewEvidence, other: SightViewEvidence) -> Decision:
    detail = (
        f"a different pose is as good: oriented overlap {other.oriented_overlap_ratio:.3f} against "
        f"{evidence.oriented_overlap_ratio:.3f}, denied surface {other.denied_ratio:.3f} against "
        f"{evidence.denied_ratio:.3f}"
    )
    return Decision(Verdict.UNDECIDED, Reason.AMBIGUOUS, min(decided.probability, 0.49), detail)


def moved_away(angle_deg: float, distance_m: float) -> Decision:
    """The answer on a given pose that refinement did not leave where it was."""
    detail = f"refinement moved the pose by {angle_deg:.2f} deg and {distance_m:.2f} m: a different pose fits better"
    return Decision(Verdict.REJECTED, Reason.AMBIGUOUS, 0.01, detail)
