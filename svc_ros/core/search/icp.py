"""Point-to-plane ICP onto the planes of a prepared scan.

The rule is small_gicp's, and so are the planes. Its own search keeps the GIL and takes three times as long: here the
grid is used that the sight lines need as well (`benchmarks/stages.py` compares the two).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import small_gicp

from svc_ros.core.config import Config
from svc_ros.core.kernels import icp as icp_kernels
from svc_ros.core.parallel import num_processors, on_all_processors
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.scans.neighbours import NearestGrid, nearest_grid
from svc_ros.core.search.prescore import thin_evenly

_PLANE_POINTS = 10


class _Search(NamedTuple):
    """How far, and how often, the nearest target points are looked for, and in what grid."""

    distance_m: float
    rounds: int
    grid: NearestGrid


def refine_by_icp(T: Array, source: PreparedScan, target: PreparedScan, config: Config, num_points: int) -> Array:
    """Pose (4, 4) after ICP, the same bits every time.

    From far away and from half as far with few points, then from a quarter as far with about `num_points` of the
    source's: what lies farther is another surface, or the other side of a thin one.
    """
    limits = config.shortlist
    few = min(limits.icp_points, num_points)
    for share, num in ((1.0, few), (0.5, few), (0.25, num_points)):
        distance_m = share * limits.icp_distance_m
        search = _Search(distance_m, limits.icp_rounds, _grid(target, distance_m, config))
        T = _align(T, _few_points(source, num), target, search)
    return T


def refine_roughly(T: Array, source: PreparedScan, target: PreparedScan, config: Config) -> Array:
    """ICP with a few hundred points from farther away: enough to see whether a hypothesis leads anywhere."""
    limits = config.shortlist
    for distance_m in (limits.rough_icp_distance_m, 0.5 * limits.rough_icp_distance_m):
        search = _Search(distance_m, limits.icp_rounds // 2, _grid(target, distance_m, config))
        T = _align(T, _few_points(source, limits.rough_points), target, search)
    return T


def index(target: PreparedScan, config: Config) -> None:
    """Build what ICP onto a scan needs; it does so itself, but several at once would each build their own."""
    limits = config.shortlist
    distances_m = [s * d for d in (limits.rough_icp_distance_m, limits.icp_distance_m) for s in (1.0, 0.5, 0.25)]
    radii_m = {_reach_m(distance_m, config) for distance_m in distances_m}
    on_all_processors(lambda radius_m: nearest_grid(target, radius_m), sorted(radii_m, reverse=True))
    _planes(target)


def _align(T: Array, points: Array, target: PreparedScan, search: _Search) -> Array:
    moved = np.array(T, np.float64)
    icp_kernels.align(
        moved, points, _planes(target), target.points, search.distance_m, search.grid.tables, search.rounds
    )  # fmt: skip
    return moved


def _few_points(scan: PreparedScan, num_points: int) -> Array:
    key = ("few_points", num_points)
    if key not in scan.memo:
        scan.memo[key] = scan.points[thin_evenly(len(scan), num_points)]
    points: Array = scan.memo[key]
    return points


def _planes(target: PreparedScan) -> Array:
    """Normals (N, 3) of the planes through every point's nearest ones, built on first use.

    The scan's own, for which a radius is searched, are those of lines where the beams are sparse.
    """
    if "planes" not in target.memo:
        cloud = small_gicp.PointCloud(target.points)
        tree = small_gicp.KdTree(target.points)
        small_gicp.estimate_normals(cloud, tree, num_neighbors=_PLANE_POINTS, num_threads=num_processors())
        target.memo["planes"] = np.ascontiguousarray(cloud.normals()[:, :3])
    planes: Array = target.memo["planes"]
    return planes


def _grid(target: PreparedScan, distance_m: float, config: Config) -> NearestGrid:
    return nearest_grid(target, _reach_m(distance_m, config))


def _reach_m(distance_m: float, config: Config) -> float:
    """Radius of the grid in which the nearest points so far away are looked for: one that is needed anyway, if any."""
    limits = config.shortlist
    needed = (config.sight_view.tolerance_m, limits.rough_icp_distance_m)
    return min((radius for radius in needed if radius >= distance_m), default=distance_m)
