"""What the sight lines say about one pose: numbers and the points behind them, no judgement."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svc_ros.core.scan import IndexArray, frozen_array


@dataclass(frozen=True, eq=False)
class SightLines:
    """The sight lines of one scan (the observer), looked at with the other scan placed in its frame.

    num_lines: sight lines that were checked; num_observed: lines along which the other scan has a point (the
    paper's region of interest); blocked_idx: (B,) indices into the observer's prepared points whose line another
    point blocks; blocker_idx: (B,) the point of the other scan that blocks it.
    num_free: directions in which the observer's sensor met nothing (0 where it tells none); num_free_blocked: of those,
    along which the other scan has surface that the sensor would have seen.
    """

    num_lines: int
    num_observed: int
    blocked_idx: IndexArray
    blocker_idx: IndexArray
    num_free: int = 0
    num_free_blocked: int = 0

    def __post_init__(self) -> None:
        for name in ("blocked_idx", "blocker_idx"):
            array = frozen_array(getattr(self, name), np.int64, f"SightLines.{name}", (None,))
            object.__setattr__(self, name, array)

    @property
    def num_blocked(self) -> int:
        """Blocked sight lines (paper: BC)."""
        return len(self.blocked_idx)

    @property
    def blocked_ratio(self) -> float:
        """Blocked share of all sight lines, in [0, 1]; 0 where there are none."""
        return self.num_blocked / self.num_lines if self.num_lines else 0.0

    @property
    def free_blocked_ratio(self) -> float:
        """Share of the free directions along which the other scan has surface, in [0, 1]."""
        return self.num_free_blocked / self.num_free if self.num_free else 0.0

    @property
    def observed_ratio(self) -> float:
        """Share of the sight lines along which the other scan has a point, in [0, 1]."""
        return self.num_observed / self.num_lines if self.num_lines else 0.0


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """Surface of one scan, placed by a pose, as the other one's sensor (the observer) saw the place where it stands.

    num_points: of the placed scan; num_confirmed: on the observer's surface, facing the same way, where it looked;
    denied_idx: (D,) indices of those that it looked through; wide_denied: their number, a cluster counting by the angle
    over which the observer sees it; num_hidden: behind what it saw; num_unseen: where it did not look.
    """

    num_points: int
    num_confirmed: int
    denied_idx: IndexArray
    wide_denied: float
    num_hidden: int
    num_unseen: int

    def __post_init__(self) -> None:
        array = frozen_array(self.denied_idx, np.int64, "SeenSurface.denied_idx", (None,))
        object.__setattr__(self, "denied_idx", array)

    @property
    def num_denied(self) -> int:
        """Points where the observer looked through."""
        return len(self.denied_idx)

    @property
    def denied_ratio(self) -> float:
        """Denied share of what the observer could see, in [0, 1]: of denied and confirmed points; 0 without any."""
        return self.num_denied / max(self.num_denied + self.num_confirmed, 1)


def no_surface() -> SeenSurface:
    """Surface of which nothing was seen."""
    return SeenSurface(0, 0, np.zeros(0, np.int64), 0.0, 0, 0)


@dataclass(frozen=True, eq=False)
class SightViewEvidence:
    """Everything that was measured of one pose.

    source_in_target: the target's sight lines, blocked by source points; target_in_source: the reverse. The same ways
    source_surface: of the source, as the target's sensor saw it; target_surface: the reverse.
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
    source_surface: SeenSurface = field(default_factory=no_surface)
    target_surface: SeenSurface = field(default_factory=no_surface)

    @property
    def surfaces(self) -> tuple[SeenSurface, SeenSurface]:
        """That of the source and that of the target."""
        return self.source_surface, self.target_surface

    @property
    def denied_ratio(self) -> float:
        """Denied share of all surface that either sensor could see, both ways together, in [0, 1]."""
        return self._share(sum(surface.num_denied for surface in self.surfaces))

    @property
    def wide_denied_ratio(self) -> float:
        """The same, clusters of denied surface counting by the angle over which they are seen."""
        return self._share(sum(surface.wide_denied for surface in self.surfaces))

    def _share(self, denied: float) -> float:
        confirmed = sum(surface.num_confirmed for surface in self.surfaces)
        return denied / max(denied + confirmed, 1.0)

    def numbers(self) -> dict[str, float | int]:
        """The evidence as flat key-values, for messages, files and the decision's model."""
        ways = {
            "source_in_target": (self.source_in_target, self.source_surface),
            "target_in_source": (self.target_in_source, self.target_surface),
        }
        found: dict[str, float | int] = {
            "denied_ratio": self.denied_ratio,
            "wide_denied_ratio": self.wide_denied_ratio,
            "overlap_ratio": self.overlap_ratio,
            "oriented_overlap_ratio": self.oriented_overlap_ratio,
            "opposed_ratio": self.opposed_ratio,
            "constraint_ratio": self.constraint_ratio,
            "weakest_constraint": self.weakest_constraint,
            "tight_ratio": self.tight_ratio,
        }
        for way, (lines, surface) in ways.items():
            found |= {
                f"denied_ratio_{way}": surface.denied_ratio,
                f"wide_denied_{way}": surface.wide_denied,
                f"num_denied_{way}": surface.num_denied,
                f"num_confirmed_{way}": surface.num_confirmed,
                f"num_hidden_{way}": surface.num_hidden,
                f"num_unseen_{way}": surface.num_unseen,
                f"num_points_{way}": surface.num_points,
                f"blocked_ratio_{way}": lines.blocked_ratio,
                f"observed_ratio_{way}": lines.observed_ratio,
                f"free_blocked_ratio_{way}": lines.free_blocked_ratio,
                f"num_blocked_{way}": lines.num_blocked,
                f"num_lines_{way}": lines.num_lines,
                f"num_free_blocked_{way}": lines.num_free_blocked,
                f"num_free_{way}": lines.num_free,
            }
        return found
