"""Sight lines: does a placed scan stand in the way of what the other sensor saw? (paper, Theorem 1)

Both directions are always looked at (paper, Algorithm 1). What decides is surface that the other sensor looked through
(`seen_surface.py`). Of the pose that is judged the blocked lines themselves are found, too: a line is blocked by the
nearest point that stands clearly before its end, where both surfaces' tangent planes tell the two points apart. The
published rule, to the letter, is in `paper_rule.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import SightViewConfig
from svc_ros.core.kernels import sight as sight_kernels
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.scans.neighbours import direction_grid, nearest_grid
from svc_ros.core.search.prescore import thinned_scan
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.free_space import count_free_blocked
from svc_ros.core.sight.placement import Placement, place
from svc_ros.core.sight.seen_surface import look_through

Way = tuple[PreparedScan, PreparedScan, Array]
_NOTHING = np.zeros(0, np.int64)


def glance(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig, num_points: int = 0
) -> SightViewEvidence:
    """What decides on a pose: the other scan's surface as both sensors saw it, and free space; no blocked lines.

    num_points: about so many points of each scan are held against the other one; 0: all.
    """
    ways = _both_ways(source, target, T_target_source)
    if num_points:
        ways = tuple((observer, thinned_scan(other, num_points), T) for observer, other, T in ways)
    (in_target, on_source), (in_source, on_target) = (_see(way, config) for way in ways)
    free = _free_space(target, in_target, config), _free_space(source, in_source, config)
    lines = SightLines(0, 0, _NOTHING, _NOTHING, *free[0]), SightLines(0, 0, _NOTHING, _NOTHING, *free[1])
    return _evidence(lines, (in_target, in_source), (on_source, on_target))


def gather_evidence(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> SightViewEvidence:
    """Look at a pose with the eyes of both sensors, and along the sight lines of both scans."""
    return look_both_ways(source, target, T_target_source, config)[0]


def look_both_ways(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> tuple[SightViewEvidence, Placement]:
    """The whole evidence of a pose, and the source placed in the target's frame."""

    def look(way: Way) -> tuple[Placement, SeenSurface, SightLines]:
        placement, seen = _see(way, config)
        return placement, seen, find_blocked(way[0], placement, config)

    ways = _both_ways(source, target, T_target_source)
    (in_target, on_source, target_lines), (in_source, on_target, source_lines) = on_all_processors(look, ways)
    return _evidence((target_lines, source_lines), (in_target, in_source), (on_source, on_target)), in_target


def _evidence(
    lines: tuple[SightLines, SightLines], placed: tuple[Placement, Placement], seen: tuple[SeenSurface, SeenSurface]
) -> SightViewEvidence:
    """Both ways together: of shares the smaller one, which both scans have in common."""
    overlap, oriented, opposed, constraint, weakest, tight = map(min, placed[0].shares(), placed[1].shares())
    return SightViewEvidence(*lines, overlap, oriented, opposed, constraint, weakest, tight, *seen)


def _see(way: Way, config: SightViewConfig) -> tuple[Placement, SeenSurface]:
    """The other scan placed before the observer, and what that one saw of it."""
    placement = place(*way, config)
    return placement, look_through(way[0], placement, config)


def _both_ways(source: PreparedScan, target: PreparedScan, T_target_source: Array) -> tuple[Way, ...]:
    """Who looks, whom it looks at, and where that one stands in its frame."""
    return (target, source, T_target_source), (source, target, se3.invert(T_target_source))


def index(scans: Sequence[PreparedScan], config: SightViewConfig) -> None:
    """Build what glances at scans need; they do so themselves, but several at once would each build their own."""
    new = [scan for scan in scans if ("nearest_grid", config.tolerance_m) not in scan.memo]
    on_all_processors(lambda scan: nearest_grid(scan, config.tolerance_m), new)


def cone_half_angle_deg(observer: PreparedScan, config: SightViewConfig) -> float:
    """Cap of the cone's half angle [deg]: a share of the sensor's own beam spacing, within bounds."""
    return min(max(config.cone_beams * observer.beam_spacing_deg, config.min_cone_deg), config.max_cone_deg)


def find_blocked(observer: PreparedScan, placement: Placement, config: SightViewConfig) -> SightLines:
    """Lines of the observer that end behind a placed point which lies on nothing of the observer's own surface."""
    grid, num = direction_grid(observer), len(observer)
    blocker, blocker_range, observed = np.full(num, -1, np.int32), np.empty(num), np.zeros(len(grid.order), bool)
    limits = (
        config.tolerance_m, config.beam_radius_voxels * observer.voxel_size_m,
        math.sin(math.radians(cone_half_angle_deg(observer, config))), math.tan(math.radians(config.max_incidence_deg)),
    )  # fmt: skip
    sight_kernels.find_blockers(
        placement.T_observer_other, placement.other.points, placement.other.normals, placement.nearest,
        observer.sensor_origin, limits, grid.tables, (blocker, blocker_range, observed),
    )  # fmt: skip
    blocked = np.flatnonzero(blocker >= 0)
    blockers = blocker[blocked].astype(np.int64)
    free = _free_space(observer, placement, config)
    return SightLines(num, int(np.count_nonzero(observed)), blocked, blockers, *free)


def _free_space(observer: PreparedScan, placement: Placement, config: SightViewConfig) -> tuple[int, int]:
    """Directions in which the observer met nothing, and those of them that the placed scan fills."""
    return len(observer.free_directions), count_free_blocked(observer, placement, config)
