"""From evidence to a verdict. Every path ends in exactly one reason."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

from svc_ros.core.decision_config import DecisionConfig
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.sight_view import Allowance

_TRAFFIC = 2.2  # factor on the blocked borders beyond which tight contact makes nothing good
_TIGHT = 0.97  # a share beyond this is no better
_HOPELESS = 0.5  # blocked share over overlap that no other evidence makes good
_BLOCKED_WEIGHT = 1.5  # a blocked line counts as much as this many agreeing points
_FLOOR = 1e-3  # smallest share that logarithms see; one sight line in a thousand


@dataclass(frozen=True)
class Decision:
    """The answer on one pose; probability in [0, 1] that the pose is right, at least one half where it is accepted."""

    verdict: Verdict
    reason: Reason
    probability: float
    detail: str


@dataclass(frozen=True)
class Margins:
    """How far the evidence lies on the good side of each border, as natural logarithms of ratios.

    free: blocked sight lines, filled free space; same_side: surfaces seen from both sides; overlap: agreeing surface,
    enough of it and facing more than one way.
    """

    free: float
    same_side: float
    overlap: float

    @property
    def smallest(self) -> float:
        """Positive where every border is kept."""
        return min(self.free, self.same_side, self.overlap)


def score(evidence: SightViewEvidence) -> float:
    """How good a refined pose looks: what overlaps on the same side, less what contradicts a sight line."""
    blocked = evidence.source_in_target.blocked_ratio + evidence.target_in_source.blocked_ratio
    return evidence.oriented_overlap_ratio - _BLOCKED_WEIGHT * blocked


def score_allowance(least_score: float) -> Allowance:
    """The blocked share beyond which a pose cannot reach that score."""
    return lambda oriented_overlap_ratio: (oriented_overlap_ratio - least_score) / _BLOCKED_WEIGHT


def blocked_allowance() -> Allowance:
    """The blocked share beyond which no pose is accepted, nor casts doubt on another."""
    return lambda oriented_overlap_ratio: _HOPELESS * max(oriented_overlap_ratio, _FLOOR)


def measure_margins(evidence: SightViewEvidence, config: DecisionConfig) -> Margins:
    """Compare the evidence with the borders; what blocks and what is opposed counts in shares of what agrees.

    Sight lines and contact are weighed together: traffic blocks many lines of a pose whose surfaces lie tightly on each
    other, a room that looks alike blocks few and agrees loosely. Where the agreeing surfaces hardly resist a shift in
    some direction (a corridor), many wrong poses agree, and each border has to be kept on its own as well.
    """
    plain = _plain_margins(evidence, config)
    most = _free_margin(evidence, _TRAFFIC * config.max_blocked_per_overlap, config, _TRAFFIC)
    free = min(_weigh(evidence, config) / config.sharpness, most, _free_space_margin(evidence, config))
    if evidence.weakest_constraint >= config.weak_constraint:
        return dataclasses.replace(plain, free=free)
    tight = _log_odds(evidence.tight_ratio) - _log_odds(config.min_tight_where_weak)
    free = min(free, _free_margin(evidence, config.max_blocked_where_weak, config))
    return Margins(free=free, same_side=plain.same_side, overlap=min(plain.overlap, tight))


def _weigh(evidence: SightViewEvidence, config: DecisionConfig) -> float:
    """Log odds that the pose is right, by its sight lines and contact (logistic regression)."""
    blocked, scattered, contradicted, tight = describe_contradiction(evidence)
    return (
        config.free_offset - config.blocked_weight * blocked - config.scattered_weight * scattered
        - config.contradicted_weight * contradicted + config.tight_weight * tight
    )  # fmt: skip


def describe_contradiction(evidence: SightViewEvidence) -> tuple[float, float, float, float]:
    """What is weighed: logarithms of the blocked and the scattered share over oriented overlap, both of the worse scan,
    and of the contradicted ratio; log odds of the tight ratio."""
    agreeing = max(evidence.oriented_overlap_ratio, _FLOOR)
    both = (evidence.source_in_target, evidence.target_in_source)
    blocked = (max(lines.blocked_ratio for lines in both) + _FLOOR) / agreeing
    scattered = (max(lines.scattered_ratio for lines in both) + _FLOOR) / agreeing
    contradicted = max(evidence.contradicted_ratio, 10.0 * _FLOOR)
    tight = min(evidence.tight_ratio, _TIGHT)
    return math.log(blocked), math.log(scattered), math.log(contradicted), _log_odds(tight)


def _plain_margins(evidence: SightViewEvidence, config: DecisionConfig) -> Margins:
    agreeing = max(evidence.oriented_overlap_ratio, _FLOOR)
    constraint = max(evidence.constraint_ratio, 0.1 * _FLOOR)
    return Margins(
        free=_free_margin(evidence, config.max_blocked_per_overlap, config),
        same_side=math.log(config.max_opposed_per_overlap * agreeing / (evidence.opposed_ratio + _FLOOR)),
        overlap=math.log(min(agreeing / config.min_oriented_overlap, constraint / config.min_constraint)),
    )


def _free_margin(
    evidence: SightViewEvidence, max_blocked: float, config: DecisionConfig, scattered_factor: float = 1.0
) -> float:
    agreeing = max(evidence.oriented_overlap_ratio, _FLOOR)
    max_scattered = scattered_factor * config.max_scattered_per_overlap

    def of(lines: SightLines) -> float:
        blocked = math.log(max_blocked * agreeing / (lines.blocked_ratio + _FLOOR))
        scattered = math.log(max_scattered * agreeing / (lines.scattered_ratio + _FLOOR))
        return min(blocked, scattered)

    return min(of(evidence.source_in_target), of(evidence.target_in_source))


def _free_space_margin(evidence: SightViewEvidence, config: DecisionConfig) -> float:
    """Infinite where neither sensor tells enough free directions, so that it can only speak against a pose."""
    largest = config.max_free_blocked_per_overlap * max(evidence.oriented_overlap_ratio, _FLOOR)
    told = [s for s in (evidence.source_in_target, evidence.target_in_source) if s.num_free >= config.min_free]
    return min((math.log(largest / (lines.free_blocked_ratio + _FLOOR)) for lines in told), default=math.inf)


def _log_odds(share: float) -> float:
    clipped = min(max(share, _FLOOR), 1.0 - _FLOOR)
    return math.log(clipped / (1.0 - clipped))


def decide(evidence: SightViewEvidence, config: DecisionConfig) -> Decision:
    """Judge one refined pose by its evidence alone."""
    margins = measure_margins(evidence, config)
    probability = 1.0 / (1.0 + math.exp(-config.sharpness * margins.smallest))
    agreeing = evidence.oriented_overlap_ratio
    if margins.smallest > 0:
        detail = f"free sight lines, oriented overlap {agreeing:.3f}"
        if probability < config.min_probability:
            why = f"probability {probability:.2f}, at least {config.min_probability:g} is asked for: {detail}"
            return Decision(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, probability, why)
        return Decision(Verdict.ACCEPTED, Reason.OK, probability, detail)
    if min(_plain_margins(evidence, config).smallest, _free_space_margin(evidence, config)) > 0:
        blocked = max(evidence.source_in_target.blocked_ratio, evidence.target_in_source.blocked_ratio)
        detail = (
            f"surfaces that resist a shift by {evidence.weakest_constraint:.3f}, {evidence.tight_ratio:.2f} of them in "
            f"tight contact: too little for blocked sight lines {blocked:.3f}"
        )
        return Decision(Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE, probability, detail)
    if margins.overlap <= min(margins.free, margins.same_side):
        return _too_little_overlap(evidence, margins, probability, config)
    return Decision(Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, probability, _contradictions(evidence))


def _contradictions(evidence: SightViewEvidence) -> str:
    ways = (evidence.source_in_target, evidence.target_in_source)
    free = max(lines.free_blocked_ratio for lines in ways)
    filled = f"filled free space {free:.3f}, " if free else ""
    blocked = max(lines.blocked_ratio for lines in ways)
    return (
        f"{filled}blocked sight lines {blocked:.3f} and surfaces seen from both sides {evidence.opposed_ratio:.3f} "
        f"against oriented overlap {evidence.oriented_overlap_ratio:.3f}"
    )


def _too_little_overlap(
    evidence: SightViewEvidence, margins: Margins, probability: float, config: DecisionConfig
) -> Decision:
    """Nothing speaks against the pose but too little speaks for it: undecided near the border, rejected far from it."""
    detail = (
        f"oriented overlap {evidence.oriented_overlap_ratio:.3f} (at least {config.min_oriented_overlap:g}), "
        f"across directions {evidence.constraint_ratio:.4f} (at least {config.min_constraint:g})"
    )
    if min(margins.free, margins.same_side) > 0 and margins.overlap > math.log(0.5):
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

    Another refined pose is as good if its sight lines are free and its score comes near; a slip, which nothing
    refined, needs less; any slip that even looks better tells that refinement stopped short of it.
    """
    if decided.verdict is not Verdict.ACCEPTED:
        return decided
    best = score(evidence)
    rivals = [e for e in doubts.others if _is_free(e, config) and score(e) > config.rival_score_ratio * best]
    rivals += [e for e in doubts.far_slips if _is_free(e, config) and score(e) > config.slip_score_ratio * best]
    rivals += [e for e in (*doubts.far_slips, *doubts.near_slips) if score(e) > best]
    return _ambiguous(decided, evidence, rivals[0]) if rivals else decided


def _is_free(evidence: SightViewEvidence, config: DecisionConfig) -> bool:
    free = _free_margin(evidence, config.max_blocked_per_overlap, config) > math.log(config.rival_strictness)
    return free and evidence.oriented_overlap_ratio > config.min_oriented_overlap


def _ambiguous(decided: Decision, evidence: SightViewEvidence, other: SightViewEvidence) -> Decision:
    detail = (
        f"a different pose is as good: oriented overlap {other.oriented_overlap_ratio:.3f} against "
        f"{evidence.oriented_overlap_ratio:.3f}, with free sight lines"
    )
    return Decision(Verdict.UNDECIDED, Reason.AMBIGUOUS, min(decided.probability, 0.49), detail)


def moved_away(angle_deg: float, distance_m: float) -> Decision:
    """The answer on a given pose that refinement did not leave where it was."""
    detail = f"refinement moved the pose by {angle_deg:.2f} deg and {distance_m:.2f} m: a different pose fits better"
    return Decision(Verdict.REJECTED, Reason.AMBIGUOUS, 0.01, detail)
