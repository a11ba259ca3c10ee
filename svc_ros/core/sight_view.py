"""Sight lines: does a placed scan stand in the way of what the other sensor saw? (paper, Theorem 1)

Default mode: a line is blocked by the nearest point that stands clearly before its end, where both surfaces' tangent
planes tell the two points apart; grazing surfaces (the ground between two rings) contradict nothing. Both directions
are always looked at (paper, Algorithm 1). The published rule, to the letter, is in `paper_rule.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3, sight_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.free_space import count_free_blocked
from svc_ros.core.neighbours import direction_grid, nearest_grid
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.placement import Placement, place
from svc_ros.core.prescore import thinned_scan
from svc_ros.core.scan import Array, IndexArray, PreparedScan

Allowance = Callable[[float], float]
_GLIMPSE_POINTS = 2500
_GLIMPSE_ERROR = 0.06  # six standard deviations of a share found with so many points


def allow_all(oriented_overlap_ratio: float) -> float:
    """No bound: every blocked line is found."""
    return math.inf


def gather_evidence(
    source: PreparedScan,
    target: PreparedScan,
    T_target_source: Array,
    config: SightViewConfig,
    allowance: Allowance = allow_all,
) -> SightViewEvidence:
    """Look along the sight lines of both scans with the other one placed by the pose.

    allowance: from the oriented overlap ratio, which is known first, to the blocked share beyond which the pose is of
    no interest; the look ends there, and its evidence is not `complete`: at least so many lines are blocked, or, where
    the allowance is below zero, none was looked at and the shares are bounds, found with few points.
    """
    if allowance(0.0) < 0.0:  # whether it is of interest at all depends on the overlap, which few points tell
        for shares in _glimpses(source, target, T_target_source, config):
            if allowance(shares[1] + _GLIMPSE_ERROR) < 0.0:
                return SightViewEvidence(_unseen(target), _unseen(source), *shares)
    ways = ((target, source, T_target_source), (source, target, se3.invert(T_target_source)))
    in_target, in_source = on_all_processors(lambda way: place(*way, config), ways)
    shares = np.minimum(in_target.shares(), in_source.shares()).tolist()
    allowed = allowance(shares[1])
    target_lines = find_blocked(target, in_target, config, allowed)
    source_lines = find_blocked(source, in_source, config, allowed if target_lines.complete else -1.0)
    return SightViewEvidence(target_lines, source_lines, *shares)


def index(scan: PreparedScan, config: SightViewConfig) -> None:
    """Build what looks at a scan need; they do so themselves, but several at once would each build their own."""
    nearest_grid(scan, config.tolerance_m)
    direction_grid(scan)
    _sectors(scan, config)
    thinned_scan(scan, _GLIMPSE_POINTS)


def _glimpses(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> Iterator[list[float]]:
    """The shares of each way, from a few points of either scan: within _GLIMPSE_ERROR of the true ones.

    Both scans have the smaller ones in common: one way can be enough to know that these are too small.
    """
    yield place(target, thinned_scan(source, _GLIMPSE_POINTS), T_target_source, config).shares().tolist()
    yield place(source, thinned_scan(target, _GLIMPSE_POINTS), se3.invert(T_target_source), config).shares().tolist()


def _unseen(observer: PreparedScan) -> SightLines:
    nothing = np.zeros(0, np.int64)
    return SightLines(len(observer), 0, nothing, nothing, complete=False)


def cone_half_angle_deg(observer: PreparedScan, config: SightViewConfig) -> float:
    """Cap of the cone's half angle [deg]: a share of the sensor's own beam spacing, within bounds."""
    return min(max(config.cone_beams * observer.beam_spacing_deg, config.min_cone_deg), config.max_cone_deg)


def find_blocked(
    observer: PreparedScan, placement: Placement, config: SightViewConfig, max_blocked_ratio: float = math.inf
) -> SightLines:
    """Lines of the observer that end behind a placed point which lies on nothing of the observer's own surface.

    The search ends as soon as more than that share of the lines is blocked.
    """
    grid, num = direction_grid(observer), len(observer)
    max_blocked = math.floor(max_blocked_ratio * num) if max_blocked_ratio < 1.0 else num
    blocker, blocker_range, observed = np.full(num, -1, np.int64), np.empty(num), np.zeros(num, bool)
    limits = np.array(
        [config.tolerance_m, config.beam_radius_voxels * observer.voxel_size_m,
         np.sin(np.radians(cone_half_angle_deg(observer, config))), np.tan(np.radians(config.max_incidence_deg))]
    )  # fmt: skip
    num_blocked = 0
    if max_blocked >= 0:
        num_blocked = sight_kernels.find_blockers(
            placement.alone, placement.alone_normals, observer.sensor_origin, limits, max_blocked,
            grid.lines, grid.order, grid.cell_starts, grid.rows, grid.columns, blocker, blocker_range, observed,
        )  # fmt: skip
    blocked = np.flatnonzero(blocker >= 0)
    scattered = count_scattered(_sectors(observer, config), blocked, config)
    complete = 0 <= num_blocked <= max_blocked
    num_free = len(observer.free_directions) if complete else 0
    free_blocked = count_free_blocked(observer, placement, config) if num_free else 0
    return SightLines(
        num, int(observed.sum()), blocked, placement.alone_idx[blocker[blocked]], scattered, complete,
        num_free, free_blocked,
    )  # fmt: skip


def _sectors(observer: PreparedScan, config: SightViewConfig) -> IndexArray:
    """Azimuth sector (N,) of each of the observer's lines, found once a scan."""
    key = ("sectors", config.sector_deg)
    if key not in observer.memo:
        observer.memo[key] = azimuth_sectors(observer.points - observer.sensor_origin, config)
    sectors: IndexArray = observer.memo[key]
    return sectors


def azimuth_sectors(relative_points: Array, config: SightViewConfig) -> IndexArray:
    """Sector (N,) of points (N, 3) [m] given relative to the sensor."""
    azimuth = np.degrees(np.arctan2(relative_points[:, 1], relative_points[:, 0])) + 180.0
    return np.floor(azimuth / config.sector_deg).astype(np.int64)


def count_scattered(sectors: IndexArray, blocked_idx: NDArray[np.int64], config: SightViewConfig) -> int:
    """Blocked lines outside the most blocked azimuth sectors; of a narrow view at most an eighth is left out."""
    num_seen = int(np.count_nonzero(np.bincount(sectors)))
    forgiven = min(config.forgiven_sectors, num_seen // 8)
    counts = np.sort(np.bincount(sectors[blocked_idx]))
    return int(counts[: max(len(counts) - forgiven, 0)].sum())
