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


def optimise(graph: PoseGraph) -> OptimisedGraph:
    """The poses with the least weighted squares of what the edges measured; the first vertex stays where it is.

    A part that no edges join to the first vertex is optimised by itself, around its own first vertex. The poses of the
    graph are what it begins with. Raises MissingDependencyError where gtsam is missing, or cannot run here.
    """
    gtsam = load_gtsam()
    num = len(graph.poses)
    poses, covariances = graph.poses.copy(), np.zeros((num, 6, 6))
    if num == 0:
        return OptimisedGraph(poses, covariances)
    part = _parts(graph)
    fixed = np.unique(part, return_index=True)[1][part] == np.arange(num)
    covariances[part != part[0]] = np.diag(np.full(6, np.inf))
    if fixed.all():
        return OptimisedGraph(poses, covariances)
    factors = factors_of(graph, fixed)
    first = gtsam.Values()
    for vertex in np.flatnonzero(~fixed).tolist():
        first.insert(vertex, gtsam.Pose3(poses[vertex]))
    found = gtsam.LevenbergMarquardtOptimizer(factors, first, optimiser_parameters()).optimize()
    marginals = gtsam.Marginals(factors, found)
    for vertex in np.flatnonzero(~fixed).tolist():
        poses[vertex] = se3.nearest_pose(found.atPose3(vertex).matrix())
        if part[vertex] == part[0]:
            to_world = adjoint(poses[vertex])
            on_the_right = marginals.marginalCovariance(vertex)[np.ix_(_TURNS_FIRST, _TURNS_FIRST)]
            covariances[vertex] = to_world @ on_the_right @ to_world.T
    return OptimisedGraph(poses, covariances)


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


def _on_the_right(edge: GraphEdge) -> Array:
    inverse = adjoint(se3.invert(edge.T_target_source))
    return np.asarray(inverse @ edge.covariance @ inverse.T)


def _noise(covariance: Array) -> Any:
    """gtsam's noise of a covariance (6, 6) of our order, of a perturbation on the right."""
    ordered = covariance[np.ix_(_TURNS_FIRST, _TURNS_FIRST)]
    return load_gtsam().noiseModel.Gaussian.Covariance(0.5 * (ordered + ordered.T), False)


def _release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:2] if part.isdigit())
