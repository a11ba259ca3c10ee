"""The published decision, Algorithms 1 and 2 to the letter: the baseline and oracle of this package."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from svc_ros.core import se3
from svc_ros.core.config import PaperConfig
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.sight.evidence import SightLines


def find_blocked(observer: PreparedScan, other_points: Array, config: PaperConfig) -> SightLines:
    """Algorithm 2: lines of the observer blocked by points (M, 3) [m] already placed in its frame.

    The non-overlap set (Eq. 6), its projection (Eq. 7, 8), the region of interest by the nearest direction (Eq. 9,
    10) and the blocked points (Eq. 11).
    """
    distance, _ = _tree(observer).query(other_points)
    alone = np.flatnonzero(distance > config.tolerance_m)
    placed, own = other_points[alone] - observer.sensor_origin, observer.points - observer.sensor_origin
    if len(alone) == 0:
        return SightLines(len(own), 0, np.zeros(0, np.int64), np.zeros(0, np.int64))
    # A point at the very origin has no direction; it keeps a finite one that is near no other.
    placed_range, own_range = (np.maximum(np.linalg.norm(a, axis=1), 1e-12) for a in (placed, own))
    placed_direction, own_direction = placed / placed_range[:, None], own / own_range[:, None]
    nearest = np.asarray(cKDTree(placed_direction).query(own_direction)[1])
    cosine = np.einsum("ij,ij->i", own_direction, placed_direction[nearest])
    in_roi = cosine > config.cone_cosine
    blocked = np.flatnonzero(in_roi & (own_range - placed_range[nearest] > config.tolerance_m))
    return SightLines(len(own), int(in_roi.sum()), blocked, alone[nearest[blocked]])


def check_both_ways(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: PaperConfig
) -> tuple[SightLines, SightLines, bool]:
    """Algorithm 1, line 6: both directions' lines, and whether the pose passes in both (BC < eta2 N)."""
    in_target = find_blocked(target, se3.apply(T_target_source, source.points), config)
    in_source = find_blocked(source, se3.apply(se3.invert(T_target_source), target.points), config)
    return in_target, in_source, passes(in_target, config) and passes(in_source, config)


def passes(lines: SightLines, config: PaperConfig) -> bool:
    """Fewer blocked lines than eta2 times the observer's points (Eq. 12)."""
    return lines.num_blocked < config.max_blocked_ratio * lines.num_lines


def _tree(scan: PreparedScan) -> cKDTree:
    if "kd_tree" not in scan.memo:
        scan.memo["kd_tree"] = cKDTree(scan.points)
    tree: cKDTree = scan.memo["kd_tree"]
    return tree
