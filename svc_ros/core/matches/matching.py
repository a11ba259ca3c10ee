"""Nearest descriptors become correspondences."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import MatchingConfig
from svc_ros.core.matches.descriptor_tree import Descriptors, DescriptorTree, NearestRows
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.scan import Array, Correspondences, IndexArray

_SAME_SQ_DISTANCE = 1e-7  # of unit rows of float32: rounding alone can make it


class Described(Protocol):
    """Points with descriptors: the Features of a scan (FPFH) or a Description.

    keypoints: (K, 3) [m]; descriptors: (K, D), rows of unit length or zeros; memo: where their tree is kept.
    """

    @property
    def keypoints(self) -> Array: ...

    @property
    def descriptors(self) -> Descriptors: ...

    @property
    def memo(self) -> dict[Hashable, Any]: ...


def match(
    source: Described, target: Described, config: MatchingConfig, num_points: int | None = None
) -> Correspondences:
    """Match every source descriptor to its nearest target descriptor, or about `num_points` of either scan.

    one_way keeps them all; mutual keeps those that are nearest in both directions, unless others are just as near;
    ratio keeps the mutual ones and ranks them by nearest over second nearest distance. The best
    `max_correspondences` are returned, in source order.
    """
    source_idx, target_idx = find_described(source, num_points), find_described(target, num_points)
    if len(source_idx) == 0 or len(target_idx) == 0:
        return Correspondences.from_points(np.zeros((0, 3)), np.zeros((0, 3)))
    a, b = source.descriptors[source_idx], target.descriptors[target_idx]
    tree_a, tree_b = on_all_processors(lambda side: descriptor_tree(side, num_points), (source, target))
    nearest = tree_b.find(a, with_second=config.strategy == "ratio")
    keep = np.arange(len(a))
    if config.strategy != "one_way":
        keep = find_mutual(nearest, b, tree_a)
        keep = keep[~find_interchangeable(a[keep], b[nearest.index[keep]], tree_a, tree_b)]
    rank_by = _distance(nearest.sq_distance)
    if nearest.sq_second is not None:
        rank_by = _ratio(rank_by, _distance(nearest.sq_second))
    chosen = _best(keep, rank_by, config.max_correspondences)
    return Correspondences(
        source.keypoints[source_idx[chosen]], target.keypoints[target_idx[nearest.index[chosen]]], rank_by[chosen]
    )


def find_mutual(nearest: NearestRows, references: Descriptors, queries: DescriptorTree) -> IndexArray:
    """Queries that are the nearest of their nearest reference, ascending.

    Only references that are the nearest of some query are looked up again, among all queries, and none of them farther
    than that query is.
    """
    within = np.full(len(references), np.inf, np.float32)
    np.minimum.at(within, nearest.index, nearest.sq_distance)
    found = np.flatnonzero(np.isfinite(within))
    back = np.full(len(references), -1)
    back[found] = queries.find(references[found], within[found]).index
    return np.flatnonzero(back[nearest.index] == np.arange(len(nearest.index)))


def find_interchangeable(
    a: Descriptors, b: Descriptors, tree_a: DescriptorTree, tree_b: DescriptorTree
) -> NDArray[np.bool_]:
    """Which matches of rows a (M, D) and b (M, D) are two of a crowd: equal, each, to a second row of the other side.

    Flat ground has thousands of such points; that two of them are mutual nearest is rounding.
    """
    crowded = np.square(a - b).sum(1) < _SAME_SQ_DISTANCE
    for rows, tree in ((a, tree_b), (b, tree_a)):
        second = tree.find(rows[crowded], with_second=True).sq_second
        if second is not None:
            crowded[crowded] = second < _SAME_SQ_DISTANCE
    return np.asarray(crowded)


def find_described(features: Described, num_points: int | None = None) -> IndexArray:
    """Indices of the points with a descriptor that is not all zeros; of many at least `num_points`, evenly."""
    described = np.flatnonzero(features.descriptors.any(1)).astype(np.int64)
    return described if num_points is None else described[:: max(1, len(described) // num_points)]


def descriptor_tree(features: Described, num_points: int | None = None) -> DescriptorTree:
    """The tree of the described points, built on first use and kept with the scan, as long as it is of these."""
    memo, key = features.memo, ("descriptor_tree", num_points)
    kept = memo.get(key)
    if kept is None or kept[0] is not features.descriptors:
        kept = features.descriptors, DescriptorTree.build(features.descriptors[find_described(features, num_points)])
        memo[key] = kept
    tree: DescriptorTree = kept[1]
    return tree


def _distance(squared: Descriptors) -> Array:
    return np.sqrt(squared.astype(np.float64))


def _ratio(distance: Array, next_distance: Array) -> Array:
    return np.divide(distance, next_distance, out=np.ones(len(distance)), where=next_distance > 0)


def _best(candidates: IndexArray, cost: Array, limit: int) -> IndexArray:
    if len(candidates) <= limit:
        return candidates
    order = np.argsort(cost[candidates], kind="stable")[:limit]
    return np.sort(candidates[order])
