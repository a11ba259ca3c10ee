"""What a registration answers: a verdict, the reason for it, and the evidence behind both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array, frozen_array
from svc_ros.core.sight.evidence import SightViewEvidence
from svc_ros.core.sight.weak_directions import WeakDirection


class Verdict(str, Enum):
    """The answer for one pair of scans. Only ACCEPTED comes with a transform."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"
    DROPPED = "dropped"  # of a stream of pairs only: the pair was never registered


class Reason(str, Enum):
    """Why the verdict is what it is. The codes are stable: other programs depend on them."""

    OK = "ok"
    SIGHT_VIEW_BLOCKED = "sight_view_blocked"
    LOW_OVERLAP = "low_overlap"
    AMBIGUOUS = "ambiguous"
    INSUFFICIENT_EVIDENCE = "insufficient_evidence"
    UNCONFIRMED = "unconfirmed"
    TOO_FEW_CORRESPONDENCES = "too_few_correspondences"
    NO_HYPOTHESIS = "no_hypothesis"
    DEGENERATE = "degenerate"
    TOO_FEW_POINTS = "too_few_points"
    UNSUPPORTED_CLOUD = "unsupported_cloud"
    TF_UNAVAILABLE = "tf_unavailable"
    TIME_SKEW = "time_skew"
    STALE = "stale"
    SUPERSEDED = "superseded"
    INACTIVE = "inactive"
    INTERNAL_ERROR = "internal_error"


@dataclass(frozen=True, eq=False)
class RegistrationResult:
    """The decision on one pair.

    T_target_source: (4, 4), present exactly if the verdict is ACCEPTED; best_candidate: (4, 4), the pose that was
    judged last or liked best, whatever the verdict (None where there was no hypothesis); covariance: (6, 6) of the
    accepted pose, order x y z [m] then rotations about x y z [rad], left perturbation in the target frame;
    probability: how sure the decision is that the best candidate is right, in [0, 1] (None where nothing was
    judged); counts: points, correspondences, hypotheses ...; time_ms: wall time of every stage and `total`;
    detail: one sentence for a person; weak_directions: how the agreeing surfaces let the best candidate be moved, none
    where they hold it every way, None where nothing was judged.
    """

    verdict: Verdict
    reason: Reason
    method: str = ""
    T_target_source: Array | None = None
    best_candidate: Array | None = None
    covariance: Array | None = None
    probability: float | None = None
    evidence: SightViewEvidence | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    time_ms: Mapping[str, float] = field(default_factory=dict)
    detail: str = ""
    weak_directions: tuple[WeakDirection, ...] | None = None

    def __post_init__(self) -> None:
        if (self.verdict is Verdict.ACCEPTED) != (self.T_target_source is not None):
            raise InputError("RegistrationResult: T_target_source belongs to an accepted verdict and to no other")
        for name, side in (("T_target_source", 4), ("best_candidate", 4), ("covariance", 6)):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value, float, f"RegistrationResult.{name}", (side, side)))

    @property
    def accepted(self) -> bool:
        """True if the transform may be used."""
        return self.verdict is Verdict.ACCEPTED
