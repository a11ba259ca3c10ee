"""Sight lines: does a placed scan stand in the way of what the other sensor saw? (paper, Theorem 1)

Default mode: a line is blocked by the nearest point that stands clearly before its end, where both surfaces' tangent
planes tell the two points apart; grazing surfaces (the ground between two rings) contradict nothing. Both directions
are always looked at (paper, Algorithm 1). The published rule, to the letter, is in `paper_rule.py`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from svc_ros.core import se3, sight_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.free_space import count_free_blocked
from svc_ros.core.neighbours import direction_grid, nearest_grid
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.placement import Placement, Shares, place
from svc_ros.core.prescore import thinned_scan
from svc_ros.core.scan import Array, IndexArray, PreparedScan

Allowance = Callable[[float], float]
Way = tuple[PreparedScan, PreparedScan, Array]
_GLIMPSE_POINTS = 2500
_GLIMPSE_ERROR = 0.06  # six standard deviations of a share found with so many points


def gather_evidence(
    source: PreparedScan,
    target: PreparedScan,
    T_target_source: Array,
    config: SightViewConfig,
    allowance: Allowance | None = None,
) -> SightViewEvidence:
    """Look along the sight lines of both scans with the other one placed by the pose.

    allowance: from the oriented overlap ratio to the blocked share beyond which the pose is of no interest; the look
    ends there, and its evidence is not `complete`: at least so many lines are blocked, and the shares are bounds, found
    one way only or with few points. Below zero none is looked at.
    """
    if allowance is None:
        return look_both_ways(source, target, T_target_source, config)[0]
    return _look_within(_both_ways(source, target, T_target_source), config, allowance)


def look_both_ways(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> tuple[SightViewEvidence, Placement]:
    """The whole evidence of a pose, and the source placed in the target's frame."""

    def look(way: Way) -> tuple[Placement, SightLines]:
        placement = place(*way, config)
        return placement, find_blocked(way[0], placement, config)

    ways = _both_ways(source, target, T_target_source)
    (in_target, target_lines), (in_source, source_lines) = on_all_processors(look, ways)
    return SightViewEvidence(target_lines, source_lines, *map(min, in_target.shares(), in_source.shares())), in_target


def _look_within(ways: tuple[Way, Way], config: SightViewConfig, allowance: Allowance) -> SightViewEvidence:
    """One way after the other, until more is blocked than allowed.

    Where it depends on the overlap whether anything is, few points are placed first: they tell it to _GLIMPSE_ERROR.
    """
    seen = [_unseen(observer) for observer, _, _ in ways]
    shares: Shares | None = None
    for k, (observer, other, T) in enumerate(ways):
        if allowance(0.0) < 0.0:
            glimpsed = place(observer, thinned_scan(other, _GLIMPSE_POINTS), T, config).shares()
            if allowance(glimpsed[1] + _GLIMPSE_ERROR) < 0.0:
                shares = _smaller(shares, glimpsed)
                break
        placement = place(observer, other, T, config)
        shares = _smaller(shares, placement.shares())
        allowed = allowance(shares[1])
        seen[k] = find_blocked(observer, placement, config, allowed)
        if not seen[k].complete or any(lines.blocked_ratio > allowed for lines in seen):
            seen[k] = dataclasses.replace(seen[k], complete=False)
            break
    assert shares is not None
    return SightViewEvidence(seen[0], seen[1], *shares)


def _smaller(known: Shares | None, found: Shares) -> Shares:
    """Both scans have the smaller shares in common."""
    return found if known is None else tuple(map(min, known, found))


def _both_ways(source: PreparedScan, target: PreparedScan, T_target_source: Array) -> tuple[Way, Way]:
    """Who looks, whom it looks at, and where that one stands in its frame."""
    return (target, source, T_target_source), (source, target, se3.invert(T_target_source))


def index(scans: Sequence[PreparedScan], config: SightViewConfig) -> None:
    """Build what looks at scans need; they do so themselves, but several at once would each build their own."""
    key = ("indexed", config.tolerance_m, config.sector_deg)

    def build(scan: PreparedScan) -> None:
        nearest_grid(scan, config.tolerance_m)
        direction_grid(scan)
        _sectors(scan, config)
        thinned_scan(scan, _GLIMPSE_POINTS)
        scan.memo[key] = True

    on_all_processors(build, [scan for scan in scans if key not in scan.memo])


def _unseen(observer: PreparedScan) -> SightLines:
    if "unseen" not in observer.memo:
        nothing = np.zeros(0, np.int64)
        observer.memo["unseen"] = SightLines(len(observer), 0, nothing, nothing, complete=False)
    lines: SightLines = observer.memo["unseen"]
    return lines


def cone_half_angle_deg(observer: PreparedScan, config: SightViewConfig) -> float:
    """Cap of the cone's half angle [deg]: a share of the sensor's own beam spacing, within bounds."""
    return min(max(config.cone_beams * observer.beam_spacing_deg, config.min_cone_deg), config.max_cone_deg)


def find_blocked(
    observer: PreparedScan, placement: Placement, config: SightViewConfig, max_blocked_ratio: float = math.inf
) -> SightLines:
    """Lines of the observer that end behind a placed point which lies on nothing of the observer's own surface.

    The search ends as soon as more than that share of the lines is blocked.
    """
    if max_blocked_ratio < 0.0:
        return _unseen(observer)
    grid, num = direction_grid(observer), len(observer)
    max_blocked = math.floor(max_blocked_ratio * num) if max_blocked_ratio < 1.0 else num
    blocker, blocker_range, observed = np.full(num, -1, np.int32), np.empty(num), np.zeros(len(grid.order), bool)
    limits = (
        config.tolerance_m, config.beam_radius_voxels * observer.voxel_size_m,
        math.sin(math.radians(cone_half_angle_deg(observer, config))), math.tan(math.radians(config.max_incidence_deg)),
    )  # fmt: skip
    num_blocked = sight_kernels.find_blockers(
        placement.T_observer_other, placement.other.points, placement.other.normals, placement.nearest,
        observer.sensor_origin, limits, max_blocked, grid.tables, (blocker, blocker_range, observed),
    )  # fmt: skip
    sectors = _sectors(observer, config)
    blocked, blockers = np.empty((2, num_blocked + 1), np.int64)
    per_sector = np.zeros(sectors.num, np.int64)
    sight_kernels.collect(blocker, sectors.of_line, blocked, blockers, per_sector)
    scattered = count_scattered(per_sector.tolist(), sectors, config)
    complete = num_blocked <= max_blocked
    num_free = len(observer.free_directions) if complete else 0
    free_blocked = count_free_blocked(observer, placement, config) if num_free else 0
    return SightLines(
        num, int(np.count_nonzero(observed)), blocked[:num_blocked], blockers[:num_blocked], scattered, complete,
        num_free, free_blocked,
    )  # fmt: skip


class Sectors(NamedTuple):
    """Azimuth sector (N,) of each of an observer's lines, how many sectors there are, and how many hold any line."""

    of_line: IndexArray
    num: int
    num_seen: int


def _sectors(observer: PreparedScan, config: SightViewConfig) -> Sectors:
    """Found once a scan."""
    key = ("sectors", config.sector_deg)
    if key not in observer.memo:
        observer.memo[key] = find_sectors(observer.points - observer.sensor_origin, config)
    sectors: Sectors = observer.memo[key]
    return sectors


def find_sectors(relative_points: Array, config: SightViewConfig) -> Sectors:
    """The sectors of points (N, 3) [m] given relative to the sensor."""
    azimuth = np.degrees(np.arctan2(relative_points[:, 1], relative_points[:, 0])) + 180.0
    of_line = np.floor(azimuth / config.sector_deg).astype(np.int64)
    num_lines = np.bincount(of_line)
    return Sectors(of_line, len(num_lines), int(np.count_nonzero(num_lines)))


def count_scattered(per_sector: Sequence[int], sectors: Sectors, config: SightViewConfig) -> int:
    """Blocked lines (S,) outside the most blocked azimuth sectors; of a narrow view at most an eighth is left out."""
    forgiven = min(config.forgiven_sectors, sectors.num_seen // 8)
    return sum(sorted(per_sector)[: max(len(per_sector) - forgiven, 0)])
