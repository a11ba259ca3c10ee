"""From evidence to a verdict. Every path ends in exactly one reason."""

from __future__ import annotations

from dataclasses import dataclass

from svc_ros.core.config import DecisionConfig
from svc_ros.core.evidence import SightViewEvidence
from svc_ros.core.result import Reason, Verdict


@dataclass(frozen=True)
class Decision:
    """The answer on one pose; probability in [0, 1] that the pose is right."""

    verdict: Verdict
    reason: Reason
    probability: float
    detail: str


def score(evidence: SightViewEvidence) -> float:
    """How good a refined pose looks: what overlaps on the same side, less what contradicts a sight line."""
    blocked = evidence.source_in_target.blocked_ratio + evidence.target_in_source.blocked_ratio
    return evidence.oriented_overlap_ratio - 1.5 * blocked


def decide(evidence: SightViewEvidence, config: DecisionConfig) -> Decision:
    """Judge one refined pose by its evidence alone."""
    oriented = evidence.oriented_overlap_ratio
    blocked = max(evidence.source_in_target.blocked_ratio, evidence.target_in_source.blocked_ratio)
    probability = min(max(score(evidence), 0.0), 1.0)
    if oriented < config.min_oriented_overlap:
        detail = f"oriented overlap {oriented:.3f} is below {config.min_oriented_overlap:g}"
        return Decision(Verdict.REJECTED, Reason.LOW_OVERLAP, probability, detail)
    if blocked / oriented > config.max_blocked_per_overlap:
        limit = f"{config.max_blocked_per_overlap:g} of the oriented overlap {oriented:.3f}"
        detail = f"blocked share {blocked:.3f} is above {limit}"
        return Decision(Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, probability, detail)
    if evidence.opposed_ratio / oriented > config.max_opposed_per_overlap:
        detail = f"surfaces seen from both sides: {evidence.opposed_ratio:.3f} against oriented overlap {oriented:.3f}"
        return Decision(Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, probability, detail)
    return Decision(Verdict.ACCEPTED, Reason.OK, probability, "free sight lines and enough agreeing surface")


def moved_away(angle_deg: float, distance_m: float) -> Decision:
    """The answer on a given pose that refinement did not leave where it was."""
    detail = f"refinement moved the pose by {angle_deg:.2f} deg and {distance_m:.2f} m: a different pose fits better"
    return Decision(Verdict.REJECTED, Reason.AMBIGUOUS, 0.0, detail)
