"""What the sight lines say about one pose: numbers and the points behind them, no judgement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core.scan import IndexArray, frozen_array

_FEW = 40  # lines, of which a share would say nothing


@dataclass(frozen=True, eq=False)
class SightLines:
    """The sight lines of one scan (the observer), looked at with the other scan placed in its frame.

    num_lines: sight lines that were checked; num_observed: lines along which the other scan has a point (the
    paper's region of interest); blocked_idx: (B,) indices into the observer's prepared points whose line another
    point blocks; blocker_idx: (B,) the point of the other scan that blocks it; num_scattered: blocked lines outside the
    few most blocked azimuth sectors: a moving object blocks one sector, a wrong pose all of them; complete: False if
    the search ended early, at least so many being blocked.
    num_free: directions in which the observer's sensor met nothing (0 where it tells none, or the search ended early);
    num_free_blocked: of those, along which the other scan has surface that the sensor would have seen.
    """

    num_lines: int
    num_observed: int
    blocked_idx: IndexArray
    blocker_idx: IndexArray
    num_scattered: int = -1  # not counted: all of them
    complete: bool = True
    num_free: int = 0
    num_free_blocked: int = 0

    def __post_init__(self) -> None:
        for name in ("blocked_idx", "blocker_idx"):
            array = frozen_array(getattr(self, name), np.int64, f"SightLines.{name}", (None,))
            object.__setattr__(self, name, array)
        if self.num_scattered < 0:
            object.__setattr__(self, "num_scattered", len(self.blocked_idx))

    @property
    def num_blocked(self) -> int:
        """Blocked sight lines (paper: BC)."""
        return len(self.blocked_idx)

    @property
    def blocked_ratio(self) -> float:
        """Blocked share of all sight lines, in [0, 1]; 0 where there are none."""
        return self.num_blocked / self.num_lines if self.num_lines else 0.0

    @property
    def scattered_ratio(self) -> float:
        """Scattered share of all sight lines, in [0, 1]."""
        return self.num_scattered / self.num_lines if self.num_lines else 0.0

    @property
    def free_blocked_ratio(self) -> float:
        """Share of the free directions along which the other scan has surface, in [0, 1]."""
        return self.num_free_blocked / self.num_free if self.num_free else 0.0

    @property
    def observed_ratio(self) -> float:
        """Share of the sight lines along which the other scan has a point, in [0, 1]."""
        return self.num_observed / self.num_lines if self.num_lines else 0.0


@dataclass(frozen=True, eq=False)
class SightViewEvidence:
    """Everything that was measured of one pose.

    source_in_target: the target's sight lines, blocked by source points; target_in_source: the reverse.
    overlap_ratio, oriented_overlap_ratio, opposed_ratio: of the smaller of both directions' shares of points with a
    neighbour within tolerance; with a neighbour whose surface faces the same way; with one that faces the opposite.
    constraint_ratio: oriented overlap times the middle eigenvalue of the agreeing normals' mean outer product (up to
    1/3): agreement on one plane alone, such as the ground, is next to none. 1 where it was not measured.
    weakest_constraint: smallest eigenvalue of that mean itself: near 0 along a corridor, 1/3 where surfaces face all
    ways. tight_ratio: share of the agreeing points that lie within a quarter of the tolerance of the other's surface.
    """

    source_in_target: SightLines
    target_in_source: SightLines
    overlap_ratio: float
    oriented_overlap_ratio: float
    opposed_ratio: float
    constraint_ratio: float = 1.0
    weakest_constraint: float = 1.0 / 3.0
    tight_ratio: float = 1.0

    @property
    def complete(self) -> bool:
        """Whether every line of both scans was looked at."""
        return self.source_in_target.complete and self.target_in_source.complete

    @property
    def contradicted_ratio(self) -> float:
        """Of the lines along which a scan shows surface that the other lacks, the share that this surface blocks.

        Seen from elsewhere most of such surface lies behind what the observer saw: of a right pose few are blocked, of
        a wrong one about half, however much else agrees. Next to 0 where there are next to none.
        """
        both = (self.source_in_target, self.target_in_source)
        return sum(lines.num_blocked for lines in both) / max(sum(lines.num_observed for lines in both), _FEW)

    def numbers(self) -> dict[str, float | int]:
        """The evidence as flat key-values, for messages, files and the decision's model."""
        near, far = self.source_in_target, self.target_in_source
        return {
            "blocked_ratio_source_in_target": near.blocked_ratio,
            "blocked_ratio_target_in_source": far.blocked_ratio,
            "overlap_ratio": self.overlap_ratio,
            "oriented_overlap_ratio": self.oriented_overlap_ratio,
            "opposed_ratio": self.opposed_ratio,
            "constraint_ratio": self.constraint_ratio,
            "weakest_constraint": self.weakest_constraint,
            "tight_ratio": self.tight_ratio,
            "contradicted_ratio": self.contradicted_ratio,
            "scattered_ratio_source_in_target": near.scattered_ratio,
            "scattered_ratio_target_in_source": far.scattered_ratio,
            "observed_ratio_source_in_target": near.observed_ratio,
            "observed_ratio_target_in_source": far.observed_ratio,
            "free_blocked_ratio_source_in_target": near.free_blocked_ratio,
            "free_blocked_ratio_target_in_source": far.free_blocked_ratio,
            "num_blocked_source_in_target": near.num_blocked,
            "num_blocked_target_in_source": far.num_blocked,
            "num_lines_source_in_target": near.num_lines,
            "num_lines_target_in_source": far.num_lines,
            "num_free_blocked_source_in_target": near.num_free_blocked,
            "num_free_blocked_target_in_source": far.num_free_blocked,
            "num_free_source_in_target": near.num_free,
            "num_free_target_in_source": far.num_free,
        }
