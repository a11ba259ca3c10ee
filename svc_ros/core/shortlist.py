"""From many hypotheses to a few distinct poses, each refined before it is judged."""

from __future__ import annotations

from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import Config, HypothesisConfig, ShortlistConfig
from svc_ros.core.parallel import num_processors
from svc_ros.core.prescore import prescore, thin_evenly
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, IndexArray, PreparedScan

_ROUNDS_A_CALL = 3


def select_distinct(T: Array, config: ShortlistConfig, limit: int) -> IndexArray:
    """Indices of at most `limit` poses (H, 4, 4), in order, none near one that stands before it."""
    chosen: list[int] = []
    free = np.ones(len(T), bool)
    for i in range(len(T)):
        if len(chosen) == limit:
            break
        if free[i]:
            chosen.append(i)
            free &= ~find_near(T, T[i], config)
    return np.asarray(chosen, np.int64)


def find_near(T: Array, pose: Array, config: ShortlistConfig) -> NDArray[np.bool_]:
    """Mask (H,) of the poses (H, 4, 4) that are the same as `pose` (4, 4) within the distinctness limits."""
    angle = se3.rotation_angle_deg(np.einsum("hji,jk->hik", T[:, :3, :3], pose[:3, :3]))
    distance = np.linalg.norm(T[:, :3, 3] - pose[:3, 3], axis=1)
    return np.asarray((angle <= config.distinct_rotation_deg) & (distance <= config.distinct_translation_m))


def refine_on_correspondences(
    T: Array, correspondences: Correspondences, hypotheses: HypothesisConfig, config: ShortlistConfig, rounds: int = -1
) -> Array:
    """Weighted Kabsch on the inliers, weights 1 / (1 + (e / eps)^2), until their number stops changing.

    At most that many rounds; as many as configured unless told otherwise.
    """
    x, y = correspondences.source_points, correspondences.target_points
    previous = -1
    for _ in range(config.correspondence_rounds if rounds < 0 else rounds):
        residual = np.linalg.norm(se3.apply(T, x) - y, axis=1)
        inlier = residual < hypotheses.inlier_threshold_m
        if inlier.sum() in (previous, 0):
            break
        previous = int(inlier.sum())
        weights = 1.0 / (1.0 + (residual[inlier] / config.correspondence_eps_m) ** 2)
        poses, valid = se3.kabsch(x[None, inlier], y[None, inlier], weights[None])
        if not valid[0]:
            break
        T = poses[0]
    return T


def refine_by_icp(
    T: Array, source: PreparedScan, target: PreparedScan, config: ShortlistConfig, num_points: int
) -> Array:
    """Pose (4, 4) after point-to-plane ICP (small_gicp, one thread: the same bits every time).

    From far away with few points first, then from half as far with about `num_points` of the source's.
    """
    few = min(config.icp_points, num_points)
    first = _align(T, (source, target), few, config.icp_distance_m, config.icp_rounds)
    return _align(first, (source, target), num_points, 0.5 * config.icp_distance_m, config.icp_rounds)


def refine_roughly(T: Array, source: PreparedScan, target: PreparedScan, config: ShortlistConfig) -> Array:
    """ICP with a few hundred points from farther away: enough to see whether a hypothesis leads anywhere."""
    for distance in (config.rough_icp_distance_m, 0.5 * config.rough_icp_distance_m):
        T = _align(T, (source, target), config.rough_points, distance, config.icp_rounds // 2)
    return T


def _align(
    T: Array, pair: tuple[PreparedScan, PreparedScan], num_points: int, distance_m: float, rounds: int
) -> Array:
    """Point-to-plane ICP, a few rounds a call: each call keeps Python's lock, and other threads wait for it."""
    source, target = pair
    for done in range(0, rounds, _ROUNDS_A_CALL):
        result = small_gicp.align(
            surface_cloud(target), thinned_cloud(source, num_points), surface_tree(target), T,
            registration_type="PLANE_ICP", max_correspondence_distance=distance_m,
            max_iterations=min(_ROUNDS_A_CALL, rounds - done), rotation_epsilon=1e-4, translation_epsilon=1e-4,
        )  # fmt: skip
        T = result.T_target_source
        if result.converged:
            break
    return se3.nearest_pose(T)


def order_by_agreement(T: Array, source: PreparedScan, target: PreparedScan, config: ShortlistConfig) -> Array:
    """The poses (H, 4, 4), those first that put most of the source on agreeing target surface."""
    agreement = prescore(T, source, target, config.prescore_cell_m, config.prescore_points)
    return T[np.argsort(-agreement, kind="stable")]


def shortlist(
    hypotheses: HypothesisSet, correspondences: Correspondences, by_agreement: Array, config: Config
) -> Array:
    """The best distinct hypotheses (S, 4, 4), refined on the correspondences.

    Drawn from the order by the scans' own agreement and, for a quarter of the places, from the hypotheses' rank.
    """
    limits = config.shortlist
    T = hypotheses.T_target_source
    by_rank = T[select_distinct(T, limits, max(1, limits.max_poses // 4))]
    first = by_agreement[select_distinct(by_agreement, limits, limits.max_poses)]
    poses = np.concatenate((by_rank, first))
    for rounds in (min(3, limits.correspondence_rounds), limits.correspondence_rounds):  # many soon become one
        poses = np.array(
            [refine_on_correspondences(T, correspondences, config.hypotheses, limits, rounds) for T in poses]
        )
        poses = poses[select_distinct(poses, limits, limits.max_poses)]
    return poses


def thinned_cloud(scan: PreparedScan, num_points: int) -> Any:
    """About `num_points` of the scan's points as a small_gicp cloud, built on first use."""
    key = ("thinned_cloud", num_points)
    if key not in scan.memo:
        scan.memo[key] = small_gicp.PointCloud(scan.points[thin_evenly(len(scan), num_points)])
    return scan.memo[key]


def surface_cloud(scan: PreparedScan) -> Any:
    """The scan as a small_gicp cloud with normals, built on first use."""
    if "surface_cloud" not in scan.memo:
        cloud = small_gicp.PointCloud(scan.points)
        small_gicp.estimate_normals(cloud, surface_tree(scan), num_neighbors=10, num_threads=num_processors())
        scan.memo["surface_cloud"] = cloud
    return scan.memo["surface_cloud"]


def surface_tree(scan: PreparedScan) -> Any:
    """The scan's kd-tree for ICP, built on first use."""
    if "surface_tree" not in scan.memo:
        scan.memo["surface_tree"] = small_gicp.KdTree(scan.points)
    return scan.memo["surface_tree"]
