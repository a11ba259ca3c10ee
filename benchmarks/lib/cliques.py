"""Hypotheses from three correspondences each, the other way to search the compatibility graph: measured, not shipped.

An edge of the graph weighs as much as both its ends have compatible correspondences in common (second order). The
heaviest edges are extended by third corners that are compatible with both ends, and three points give a pose. SC2-PCR
takes sets of six to twenty instead.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig
from svc_ros.core.kernels import compatibility as kernels
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, IndexArray
from svc_ros.core.search.compatibility import compute_compatibility
from svc_ros.core.search.hypotheses import drop_tilted, rank

MAX_CORRESPONDENCES = 2000  # those with the nearest descriptors; weights of all pairs of them are held at once
CORNERS_AN_EDGE = 2
_SHORTEST_EDGE = 5.0  # in compatibility thresholds: shorter ones are compatible whatever they are, and fix no rotation

Weights = NDArray[np.int32]


def generate_clique_hypotheses(correspondences: Correspondences, config: HypothesisConfig) -> HypothesisSet:
    """Poses T_target_source of the heaviest triangles, scored over all correspondences, best first.

    Takes the place of `svc_ros.core.search.hypotheses.generate_hypotheses`.
    """
    strongest = select_strongest(correspondences)
    x, y = strongest.source_points, strongest.target_points
    weights = weigh_edges(strongest, config.compatibility_threshold_m)
    triangles = extend(heaviest_edges(weights), weights)
    T, valid = se3.kabsch(x[triangles], y[triangles], np.ones(triangles.shape))
    T = T[valid]
    return rank(drop_tilted(T, config.max_tilt_deg) if config.gravity_aligned else T, correspondences, config)


def select_strongest(correspondences: Correspondences) -> Correspondences:
    """At most MAX_CORRESPONDENCES, in their order."""
    chosen = np.sort(np.argsort(correspondences.distance, kind="stable")[:MAX_CORRESPONDENCES])
    fields = (f.name for f in dataclasses.fields(correspondences))
    return Correspondences(*(getattr(correspondences, name)[chosen] for name in fields))


def weigh_edges(correspondences: Correspondences, threshold_m: float) -> Weights:
    """Weights (N, N) of compatible pairs: how many correspondences are compatible with both; 0 for all other pairs."""
    tight = compute_compatibility(correspondences, threshold_m).tight
    weights = np.zeros((len(correspondences),) * 2, np.int32)
    for i, row in enumerate(weights):
        kernels.second_order_row(i, tight, tight, row)
    weights[_sq_distances(correspondences.source_points) < (_SHORTEST_EDGE * threshold_m) ** 2] = 0
    return weights


def heaviest_edges(weights: Weights) -> IndexArray:
    """The heaviest edge of each corner, (E, 2), each once.

    The heaviest of all lie in one part of the scan and, at low overlap, often in a wrong one.
    """
    if len(weights) == 0:
        return np.zeros((0, 2), np.int64)
    first, second = np.arange(len(weights)), weights.argmax(1)
    edges = np.stack((np.minimum(first, second), np.maximum(first, second)), 1)
    return np.unique(edges[weights[first, second] > 0], axis=0)


def extend(edges: IndexArray, weights: Weights) -> IndexArray:
    """Triangles (M, 3): each edge (E, 2) with the corners that are joined to both ends by the heaviest two edges."""
    to_first, to_second = weights[edges[:, 0]], weights[edges[:, 1]]
    both = np.where((to_first > 0) & (to_second > 0), to_first + to_second, 0)
    corners = np.argpartition(-both, CORNERS_AN_EDGE, axis=1)[:, :CORNERS_AN_EDGE]
    triangles = np.concatenate((np.repeat(edges, corners.shape[1], axis=0), corners.reshape(-1, 1)), axis=1)
    return np.unique(np.sort(triangles[np.take_along_axis(both, corners, 1).ravel() > 0], axis=1), axis=0)


def _sq_distances(points: Array) -> Array:
    squares = (points**2).sum(1)
    return np.asarray(squares[:, None] + squares - 2.0 * points @ points.T)
