"""Sight lines: does a placed scan stand in the way of what the other sensor saw? (paper, Theorem 1)

Default mode: a line is blocked by the nearest point that stands clearly before its end, where both surfaces' tangent
planes tell the two points apart; grazing surfaces (the ground between two rings) contradict nothing. Both directions
are always looked at (paper, Algorithm 1). The published rule, to the letter, is in `paper_rule.py`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3, sight_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.neighbours import direction_grid, radius_grid
from svc_ros.core.scan import Array, PreparedScan


def gather_evidence(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> SightViewEvidence:
    """Look along the sight lines of both scans with the other one placed by the pose."""
    in_target, source_shares = _look(target, source, T_target_source, config)
    in_source, target_shares = _look(source, target, se3.invert(T_target_source), config)
    return SightViewEvidence(in_target, in_source, *np.minimum(source_shares, target_shares).tolist())


def _look(
    observer: PreparedScan, other: PreparedScan, T_observer_other: Array, config: SightViewConfig
) -> tuple[SightLines, Array]:
    """The observer's sight lines, and shares of the other scan: it overlaps, agrees, is opposed, constrains."""
    points, normals = se3.apply(T_observer_other, other.points), se3.rotate(T_observer_other, other.normals)
    nearest = radius_grid(observer, config.tolerance_m).nearest(points)
    near = nearest >= 0
    surface = observer.normals[nearest[near]]
    cosine = np.einsum("ij,ij->i", normals[near], surface)
    same, opposed = cosine > config.same_side_cosine, int((cosine < -config.same_side_cosine).sum())
    planes, num_same = surface[same], max(int(same.sum()), 1)
    offset = points[near][same] - observer.points[nearest[near][same]]
    tight = np.abs(np.einsum("ij,ij->i", offset, planes)) < 0.25 * config.tolerance_m
    weakest, middle, _ = np.maximum(np.linalg.eigvalsh(planes.T @ planes), 0.0)  # sums, so they weigh how much agrees
    of_all = np.array([near.sum(), same.sum(), opposed, middle]) / len(points)
    shares = np.concatenate((of_all, np.array([weakest, tight.sum()]) / num_same))
    return _find_blocked(observer, points, normals, ~near, config), shares


def cone_half_angle_deg(observer: PreparedScan, config: SightViewConfig) -> float:
    """Cap of the cone's half angle [deg]: a share of the sensor's own beam spacing, within bounds."""
    return min(max(config.cone_beams * observer.beam_spacing_deg, config.min_cone_deg), config.max_cone_deg)


def _find_blocked(
    observer: PreparedScan, points: Array, normals: Array, alone: NDArray[np.bool_], config: SightViewConfig
) -> SightLines:
    """Blocked lines of the observer, with the points (M, 3) that lie on nothing of its scan as possible blockers."""
    grid = direction_grid(observer)
    num = len(observer)
    cone_deg = cone_half_angle_deg(observer, config)
    blocker, blocker_range, observed = np.full(num, -1, np.int64), np.zeros(num), np.zeros(num, bool)
    limits = np.array(
        [config.tolerance_m, config.beam_radius_voxels * observer.voxel_size_m,
         np.radians(cone_deg), np.tan(np.radians(config.max_incidence_deg))]
    )  # fmt: skip
    names = np.flatnonzero(alone)
    sight_kernels.find_blockers(
        points[names] - observer.sensor_origin, normals[names], names, grid.points, grid.normals, grid.order,
        grid.cell_starts, grid.rows, grid.columns, limits, blocker, blocker_range, observed,
    )  # fmt: skip
    blocked = np.flatnonzero(blocker >= 0)
    scattered = count_scattered(observer.points - observer.sensor_origin, blocked, config)
    return SightLines(num, int(observed.sum()), blocked, blocker[blocked], scattered)


def count_scattered(relative_points: Array, blocked_idx: NDArray[np.int64], config: SightViewConfig) -> int:
    """Blocked lines outside the most blocked azimuth sectors; of a narrow view at most an eighth is left out."""
    azimuth = np.degrees(np.arctan2(relative_points[:, 1], relative_points[:, 0])) + 180.0
    sector = np.floor(azimuth / config.sector_deg).astype(np.int64)
    num_seen = int(np.count_nonzero(np.bincount(sector)))
    forgiven = min(config.forgiven_sectors, num_seen // 8)
    counts = np.sort(np.bincount(sector[blocked_idx]))
    return int(counts[: max(len(counts) - forgiven, 0)].sum())
