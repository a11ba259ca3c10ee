"""Nearest descriptors become correspondences."""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import MatchingConfig
from svc_ros.core.descriptor_tree import Descriptors, DescriptorTree, NearestRows
from svc_ros.core.scan import Array, Correspondences, Features, IndexArray


def match(source: Features, target: Features, config: MatchingConfig) -> Correspondences:
    """Match every source descriptor to its nearest target descriptor.

    one_way keeps them all; mutual keeps those that are nearest in both directions; ratio keeps the mutual ones and
    ranks them by nearest over second nearest distance. The best `max_correspondences` are returned, in source order.
    """
    source_idx, target_idx = find_described(source), find_described(target)
    if len(source_idx) == 0 or len(target_idx) == 0:
        return Correspondences.from_points(np.zeros((0, 3)), np.zeros((0, 3)))
    queries, references = source.descriptors[source_idx], target.descriptors[target_idx]
    nearest = descriptor_tree(target).find(queries, with_second=config.strategy == "ratio")
    one_way = config.strategy == "one_way"
    keep = np.arange(len(queries)) if one_way else find_mutual(nearest, references, descriptor_tree(source))
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


def find_described(features: Features) -> IndexArray:
    """Indices of the points that have a descriptor, one that is not all zeros."""
    return np.flatnonzero(features.descriptors.any(1)).astype(np.int64)


def descriptor_tree(features: Features) -> DescriptorTree:
    """The tree of the described points, built on first use and kept with the scan, as long as it is of these."""
    memo = features.prepared.memo
    kept = memo.get("descriptor_tree")
    if kept is None or kept[0] is not features.descriptors:
        kept = features.descriptors, DescriptorTree.build(features.descriptors[find_described(features)])
        memo["descriptor_tree"] = kept
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
