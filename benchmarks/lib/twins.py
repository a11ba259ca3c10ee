"""What the kernels are compared with: the same answers by cKDTree and by dense numpy, as one would write them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig, PaperConfig, SightViewConfig
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, IndexArray, PreparedScan
from svc_ros.core.sight.evidence import SightLines
from svc_ros.core.sight.sight_view import cone_half_angle_deg

_POSES_AT_A_TIME = 64


@dataclass(frozen=True, eq=False)
class KdObserver:
    """A prepared scan with all that its sight lines need and no pose changes: trees, ranges and incidence."""

    scan: PreparedScan
    tree: cKDTree
    directions: cKDTree
    lines: Array
    ranges: Array
    tangents: Array

    @classmethod
    def build(cls, scan: PreparedScan, config: SightViewConfig) -> KdObserver:
        """Index the points, and the directions in which they are seen."""
        lines = scan.points - scan.sensor_origin
        ranges = np.maximum(np.linalg.norm(lines, axis=1), 1e-12)
        cosine = np.abs(np.einsum("ij,ij->i", lines, scan.normals)) / ranges
        tangents = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / np.maximum(cosine, 1e-9)
        tangents = np.minimum(tangents, np.tan(np.radians(config.max_incidence_deg)))
        return cls(scan, cKDTree(scan.points), cKDTree(lines / ranges[:, None]), lines, ranges, tangents)


def look_by_trees(
    observer: KdObserver, other: PreparedScan, T_observer_other: Array, config: SightViewConfig
) -> tuple[SightLines, Array]:
    """The observer's sight lines, and the shares of the other scan that lie, agree and are opposed on its surface."""
    points, normals = se3.apply(T_observer_other, other.points), se3.rotate(T_observer_other, other.normals)
    _, nearest = observer.tree.query(points, distance_upper_bound=config.tolerance_m)
    near = nearest < len(observer.scan)
    surface = observer.scan.normals[nearest[near]]
    cosine = np.einsum("ij,ij->i", normals[near], surface)
    same = cosine > config.same_side_cosine
    planes = surface[same]
    offset = points[near][same] - observer.scan.points[nearest[near][same]]
    tight = np.abs(np.einsum("ij,ij->i", offset, planes)) < 0.25 * config.tolerance_m
    weakest, middle, _ = np.maximum(np.linalg.eigvalsh(planes.T @ planes), 0.0)
    of_all = np.array([near.sum(), same.sum(), (cosine < -config.same_side_cosine).sum(), middle]) / len(points)
    shares = np.concatenate((of_all, np.array([weakest, tight.sum()]) / max(int(same.sum()), 1)))
    return _blocked_by_trees(observer, points, normals, np.flatnonzero(~near), config), shares


def _blocked_by_trees(
    observer: KdObserver, points: Array, normals: Array, alone: IndexArray, config: SightViewConfig
) -> SightLines:
    scan, tolerance = observer.scan, config.tolerance_m
    p = points[alone] - scan.sensor_origin
    p_range = np.linalg.norm(p, axis=1)
    radius = config.beam_radius_voxels * scan.voxel_size_m
    outside = p_range > radius
    alone, p, p_range = alone[outside], p[outside], p_range[outside]
    angle = np.minimum(np.arcsin(radius / p_range), np.radians(cone_half_angle_deg(scan, config)))
    of_p, line = _pairs_in_cones(observer, p / p_range[:, None], angle)
    q, q_range, r = observer.lines[line], observer.ranges[line], p_range[of_p]
    along = np.einsum("ij,ij->i", p[of_p], q) / q_range
    sq_offset = r**2 - along**2
    seen = (along > 0) & (sq_offset <= (r * np.sin(angle[of_p])) ** 2)
    num_observed = int(np.count_nonzero(np.bincount(line[seen])))
    rise = np.sqrt(np.maximum(sq_offset, 0.0)) * observer.tangents[line]
    hits = np.flatnonzero(seen & (q_range - r > tolerance + rise))
    of_p, line = of_p[hits], line[hits]
    gap = p[of_p] - observer.lines[line]
    off_q = np.abs(np.einsum("ij,ij->i", gap, scan.normals[line])) > tolerance
    off_p = np.abs(np.einsum("ij,ij->i", gap, normals[alone[of_p]])) > tolerance
    of_p, line = of_p[off_q & off_p], line[off_q & off_p]
    order = np.lexsort((of_p, p_range[of_p], line))
    blocked, place = np.unique(line[order], return_index=True)
    blocker = alone[of_p[order[place]]]
    return SightLines(len(scan), num_observed, blocked, blocker)


def _pairs_in_cones(observer: KdObserver, directions: Array, angle: Array) -> tuple[IndexArray, IndexArray]:
    """Which lines point almost the way of which of the directions (M, 3): two arrays of indices."""
    chord = 2.0 * np.sin(0.5 * angle) * (1.0 + 1e-9) + 1e-12
    found = observer.directions.query_ball_point(directions, chord, return_sorted=False)
    counts = np.fromiter(map(len, found), np.int64, len(found))
    line = np.fromiter(chain.from_iterable(found), np.int64, int(counts.sum()))
    return np.repeat(np.arange(len(found)), counts), line


def paper_by_trees(observer: KdObserver, other_points: Array, config: PaperConfig) -> SightLines:
    """Algorithm 2 of the paper for points (M, 3) [m] in the observer's frame."""
    distance, _ = observer.tree.query(other_points)
    alone = np.flatnonzero(distance > config.tolerance_m)
    empty = np.zeros(0, np.int64)
    if len(alone) == 0:
        return SightLines(len(observer.scan), 0, empty, empty)
    placed = other_points[alone] - observer.scan.sensor_origin
    placed_range = np.maximum(np.linalg.norm(placed, axis=1), 1e-12)
    own_directions = observer.lines / observer.ranges[:, None]
    directions = placed / placed_range[:, None]
    nearest = np.asarray(cKDTree(directions).query(own_directions)[1])
    in_roi = np.einsum("ij,ij->i", own_directions, directions[nearest]) > config.cone_cosine
    blocked = np.flatnonzero(in_roi & (observer.ranges - placed_range[nearest] > config.tolerance_m))
    return SightLines(len(observer.scan), int(in_roi.sum()), blocked, alone[nearest[blocked]])


# --- hypotheses -----------------------------------------------------------------------------------------------


def dense_hypotheses(correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    """SC2-PCR with dense N x N matrices; second-order rows of the seeds only, by one matrix product."""
    x, y = correspondences.source_points, correspondences.target_points
    threshold = config.compatibility_threshold_m
    between, delta = cdist(x, x), cdist(y, y)
    np.abs(np.subtract(between, delta, out=delta), out=delta)  # new large arrays would cost more than the sums
    seeds = _dense_seeds(between, _confidence(delta, config), config)
    loose, tight = delta < threshold, (delta < 0.5 * threshold).astype(np.float32)
    second_order = loose[seeds] * (tight[seeds] @ tight)
    members, valid = _largest(second_order.astype(np.int64), config.first_consensus)
    with_seed = loose[seeds[:, None], members] & valid
    inside = (loose[members[:, :, None], members[:, None, :]] @ with_seed[:, :, None].astype(np.int64))[:, :, 0]
    chosen, valid = _largest(np.where(with_seed, inside, 0), config.second_consensus)
    sets = np.where(valid, np.take_along_axis(members, chosen, 1), 0)
    T, solved = se3.kabsch(x[sets], y[sets], _set_weights(delta, sets, valid, config))
    return _dense_rank(T[solved & (valid.sum(1) >= 3)], correspondences, config)


def _confidence(delta: Array, config: HypothesisConfig) -> Array:
    A = delta / config.compatibility_threshold_m
    np.subtract(1.0, np.square(A, out=A), out=A)
    np.maximum(0.0, A, out=A)
    vector = np.ones(len(A))
    for _ in range(config.power_iterations):
        vector = A @ vector
        vector /= np.linalg.norm(vector)
    return vector


def _dense_seeds(between: Array, confidence: Array, config: HypothesisConfig) -> IndexArray:
    beaten = ((between <= config.nms_radius_m) & (confidence[None] > confidence[:, None])).any(1)
    maxima = np.flatnonzero(~beaten)
    limit = min(config.max_seeds, max(1, int(config.seed_ratio * len(confidence))))
    return maxima[np.argsort(-confidence[maxima], kind="stable")][:limit]


def _largest(rows: IndexArray, k: int) -> tuple[IndexArray, NDArray[np.bool_]]:
    """Columns (S, k) of the k largest entries of each row, ties to the smaller column, and which are positive."""
    width = rows.shape[1]
    key = rows * width + np.arange(width - 1, -1, -1)
    columns = np.argpartition(-key, min(k, width) - 1, axis=1)[:, :k]
    columns = np.take_along_axis(columns, np.argsort(-np.take_along_axis(key, columns, 1), axis=1), 1)
    return columns, np.take_along_axis(rows, columns, 1) > 0


def _set_weights(delta: Array, sets: IndexArray, valid: NDArray[np.bool_], config: HypothesisConfig) -> Array:
    ratio = delta[sets[:, :, None], sets[:, None, :]] / config.compatibility_threshold_m
    W = np.maximum(0.0, 1.0 - ratio**2) * (valid[:, :, None] & valid[:, None, :])
    W[:, np.arange(sets.shape[1]), np.arange(sets.shape[1])] = 0.0
    vector = valid.astype(np.float64)[:, :, None]
    for _ in range(config.power_iterations):
        vector = W @ vector
        vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-300)
    return np.asarray(vector[:, :, 0])


def _dense_rank(T: Array, correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    x, y, threshold = correspondences.source_points, correspondences.target_points, config.inlier_threshold_m
    num_inliers, score = np.zeros(len(T), np.int64), np.zeros(len(T))
    power = {"ic": 0, "mae": 1, "mse": 2}[config.ranking]
    for k in range(0, len(T), _POSES_AT_A_TIME):
        R, t = T[k : k + _POSES_AT_A_TIME, :3, :3], T[k : k + _POSES_AT_A_TIME, :3, 3:]
        error = np.sqrt(((R @ x.T + t - y.T) ** 2).sum(1))
        inlier = error < threshold
        num_inliers[k : k + _POSES_AT_A_TIME] = inlier.sum(1)
        score[k : k + _POSES_AT_A_TIME] = (inlier * (1.0 - error / threshold) ** power).sum(1)
    order = np.argsort(-score, kind="stable")
    return HypothesisSet(T[order], num_inliers[order], score[order])
