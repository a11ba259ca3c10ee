"""Which sight lines and denied points of a scan are drawn: one choice for RViz and for the report."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from svc_ros.core.scan import IndexArray
from svc_ros.core.sight.evidence import SeenSurface, SightLines

MAX_LINES = 400  # of each kind and scan: more is a ball of wool, and each costs time
MAX_DENIED = 1000  # denied points of each scan: they show which surface it is
DENIED_SIZE = 0.5  # of the voxels, when they are drawn: neighbours look like the surface that they are


class DrawnLines(NamedTuple):
    """Indices of the observer's prepared points at which the drawn lines from its sensor end.

    clear_idx: (C,), lines that nothing blocks; blocked_idx: (B,), lines that a point of the other scan blocks.
    """

    clear_idx: IndexArray
    blocked_idx: IndexArray


def choose_lines(lines: SightLines, num_points: int, max_lines: int = MAX_LINES) -> DrawnLines:
    """At most `max_lines` of each kind, evenly chosen among the lines of a scan of `num_points` points."""
    is_clear = np.ones(num_points, bool)
    is_clear[lines.blocked_idx] = False
    return DrawnLines(
        choose_evenly(np.flatnonzero(is_clear), max_lines), choose_evenly(np.flatnonzero(~is_clear), max_lines)
    )


def choose_denied(surface: SeenSurface, max_denied: int = MAX_DENIED) -> IndexArray:
    """At most `max_denied` of the points that the other sensor looked through, evenly chosen."""
    return choose_evenly(surface.denied_idx, max_denied)


def choose_evenly(indices: IndexArray, max_num: int) -> IndexArray:
    """At most `max_num` of the indices (N,), in their order, the first and the last among them."""
    places = np.linspace(0, len(indices) - 1, min(len(indices), max_num))
    chosen: IndexArray = indices[places.astype(np.int64)]
    return chosen
