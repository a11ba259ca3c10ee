"""Poses that fit all edges of a pose graph best, and how well they are known. Needs gtsam (extra: graph)."""

from __future__ import annotations

import functools
import importlib.util
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from svc_ros.core import se3
from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge, PoseGraph, adjoint
from svc_ros.io.trajectories import Trajectory
from svc_ros.io.transforms import interpolate_poses

_MAX_ITERATIONS, _TOLERANCE = 100, 1e-9
_TURNS_FIRST = np.array([3, 4, 5, 0, 1, 2])  # gtsam's order; taken twice it is the order it was


@dataclass(frozen=True, eq=False)
class OptimisedGraph:
    """What became of a graph's vertices.

    poses: (N, 4, 4) [m], in the graph's world frame; covariances: (N, 6, 6), of each relative to the first, order x y z
    [m] then rotations about x y z [rad], left perturbation in the world frame. Zero for the first vertex; vertices that
    no edges join to it have inf on the diagonal.
    """

    poses: Array
    covariances: Array


def optimise_poses(graph: PoseGraph) -> Array:
    """The poses (N, 4, 4) with the least weighted squares of what the edges measured; the first vertex stays.

    A part that no edges join to the first vertex is optimised by itself, around its own first vertex. The poses of the
    graph are what it begins with. Raises MissingDependencyError where gtsam is missing, or cannot run here.
    """
    gtsam, poses = load_gtsam(), graph.poses.copy()
    fixed = _fixed(_parts(graph))
    if fixed.all():
        return poses
    first, free = gtsam.Values(), np.flatnonzero(~fixed).tolist()
    for vertex in free:
        first.insert(vertex, gtsam.Pose3(poses[vertex]))
    found = gtsam.LevenbergMarquardtOptimizer(factors_of(graph, fixed), first, optimiser_parameters()).optimize()
    for vertex in free:
        poses[vertex] = se3.nearest_pose(found.atPose3(vertex).matrix())
    return poses


def optimise(graph: PoseGraph) -> OptimisedGraph:
    """The poses as `optimise_poses` finds them, and how well they are known, which takes as long again."""
    gtsam, poses = load_gtsam(), optimise_poses(graph)
    covariances, part = np.zeros((len(poses), 6, 6)), _parts(graph)
    fixed = _fixed(part)
    if fixed.all():
        covariances[part != part[:1]] = np.diag(np.full(6, np.inf))
        return OptimisedGraph(poses, covariances)
    values = gtsam.Values()
    for vertex in np.flatnonzero(~fixed).tolist():
        values.insert(vertex, gtsam.Pose3(poses[vertex]))
    marginals = gtsam.Marginals(factors_of(graph, fixed), values)
    covariances[part != part[0]] = np.diag(np.full(6, np.inf))
    for vertex in np.flatnonzero(~fixed & (part == part[0])).tolist():
        to_world = adjoint(poses[vertex])
        on_the_right = marginals.marginalCovariance(vertex)[np.ix_(_TURNS_FIRST, _TURNS_FIRST)]
        covariances[vertex] = to_world @ on_the_right @ to_world.T
    return OptimisedGraph(poses, covariances)


def correct_trajectory(odometry: Trajectory, keyframes: Trajectory, optimised: Array) -> Trajectory:
    """The poses of odometry, moved with the keyframes around them; optimised: (N, 4, 4), of these.

    Each pose stands to the keyframe before it and to the one after it as in odometry; where the two say different, it
    lies between by its stamp. Before the first and after the last keyframe it goes with that one alone.
    """
    num = len(keyframes)
    if num == 0:
        return odometry
    moves = optimised @ se3.invert(keyframes.poses)
    following = np.searchsorted(keyframes.stamps_ns, odometry.stamps_ns)
    before, after = np.clip(following - 1, 0, num - 1), np.clip(following, 0, num - 1)
    from_ns, to_ns = keyframes.stamps_ns[before], keyframes.stamps_ns[after]
    shares = np.clip((odometry.stamps_ns - from_ns) / np.maximum(to_ns - from_ns, 1), 0.0, 1.0)
    poses = [
        interpolate_poses(moves[k] @ T, moves[n] @ T, share)
        for k, n, T, share in zip(before, after, odometry.poses, shares.tolist(), strict=True)
    ]
    return Trajectory(odometry.stamps_ns, np.array(poses).reshape(-1, 4, 4))


@functools.cache
def load_gtsam() -> Any:
    """The module gtsam; MissingDependencyError says what to do where it is missing or would end the process."""
    if importlib.util.find_spec("gtsam") is None:
        raise MissingDependencyError("optimising a pose graph needs gtsam: pip install 'svc_ros[graph]'")
    version, numpy_version = metadata.version("gtsam"), np.__version__
    # Its wheels before 4.3 are built for numpy 1, and beside numpy 2 they end the process without a word.
    if _release(version) < (4, 3) and _release(numpy_version) >= (2,):
        raise MissingDependencyError(
            f"gtsam {version} does not work with numpy {numpy_version}: "
            "pip install 'gtsam>=4.3', or on Python 3.10 pip install 'numpy<2'"
        )
    import gtsam

    return gtsam


def factors_of(graph: PoseGraph, fixed: NDArray[np.bool_]) -> Any:
    """The edges as gtsam's factors; what joins a vertex to one of the fixed ones (N,) says where it stands."""
    gtsam = load_gtsam()
    factors = gtsam.NonlinearFactorGraph()
    for edge in graph.edges:
        if edge.source == edge.target or (fixed[edge.source] and fixed[edge.target]):
            continue
        T = edge.T_target_source
        if fixed[edge.source]:
            pose = graph.poses[edge.source] @ se3.invert(T)
            factors.add(gtsam.PriorFactorPose3(edge.target, gtsam.Pose3(pose), _noise(edge.covariance)))
        elif fixed[edge.target]:
            pose = graph.poses[edge.target] @ T
            factors.add(gtsam.PriorFactorPose3(edge.source, gtsam.Pose3(pose), _noise(_on_the_right(edge))))
        else:
            noise = _noise(_on_the_right(edge))
            factors.add(gtsam.BetweenFactorPose3(edge.target, edge.source, gtsam.Pose3(T), noise))
    return factors


def optimiser_parameters() -> Any:
    """Those of gtsam's Levenberg-Marquardt."""
    parameters = load_gtsam().LevenbergMarquardtParams()
    parameters.setMaxIterations(_MAX_ITERATIONS)
    parameters.setRelativeErrorTol(_TOLERANCE)
    parameters.setAbsoluteErrorTol(_TOLERANCE)
    return parameters


def _parts(graph: PoseGraph) -> NDArray[np.int64]:
    """(N,), which part each vertex belongs to; of two vertices that edges join it is the same one."""
    ends = np.array([(edge.source, edge.target) for edge in graph.edges], np.int64).reshape(-1, 2)
    num = len(graph.poses)
    joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(num, num))
    return np.asarray(connected_components(joined, directed=False)[1], np.int64)


def _fixed(part: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,), the first vertex of each part."""
    fixed = np.zeros(len(part), bool)
    fixed[np.unique(part, return_index=True)[1]] = True
    return fixed


def _on_the_right(edge: GraphEdge) -> Array:
    inverse = adjoint(se3.invert(edge.T_target_source))
    return np.asarray(inverse @ edge.covariance @ inverse.T)


def _noise(covariance: Array) -> Any:
    """gtsam's noise of a covariance (6, 6) of our order, of a perturbation on the right."""
    ordered = covariance[np.ix_(_TURNS_FIRST, _TURNS_FIRST)]
    return load_gtsam().noiseModel.Gaussian.Covariance(0.5 * (ordered + ordered.T), False)


def _release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:2] if part.isdigit())
