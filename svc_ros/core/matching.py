"""Nearest descriptors become correspondences."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import MatchingConfig
from svc_ros.core.scan import Correspondences, Features, IndexArray

_BLOCK_ROWS = 1024  # bounds the similarity block to a few tens of megabytes


def match(source: Features, target: Features, config: MatchingConfig) -> Correspondences:
    """Match every source descriptor to its nearest target descriptor.

    one_way keeps them all; mutual keeps those that are nearest in both directions; ratio keeps the mutual ones and
    ranks them by nearest over second nearest distance. The best `max_correspondences` are returned, in source order.
    """
    source_idx, target_idx = _described(source), _described(target)
    a, b = source.descriptors[source_idx], target.descriptors[target_idx]
    nearest, distance, ratio = find_nearest(a, b)
    keep = np.ones(len(nearest), bool)
    if config.strategy != "one_way" and len(nearest):
        back, _, _ = find_nearest(b, a)
        keep = back[nearest] == np.arange(len(nearest))
    rank_by = ratio if config.strategy == "ratio" else distance
    chosen = _best(np.flatnonzero(keep), rank_by, config.max_correspondences)
    return Correspondences(
        source.keypoints[source_idx[chosen]], target.keypoints[target_idx[nearest[chosen]]], rank_by[chosen]
    )


def find_nearest(
    queries: NDArray[np.float32], references: NDArray[np.float32]
) -> tuple[IndexArray, NDArray[np.float64], NDArray[np.float64]]:
    """Nearest reference of each unit-length query by BLAS blocks.

    Returns its index (Q,), its distance (Q,) and the ratio (Q,) of nearest to second nearest distance. Of equally
    near references the first is taken.
    """
    num = len(queries)
    index = np.zeros(num, np.int64)
    best, second = np.full(num, -np.inf, np.float32), np.full(num, -np.inf, np.float32)
    if len(references) == 0:
        return index[:0], np.zeros(0), np.zeros(0)
    for start in range(0, num, _BLOCK_ROWS):
        similarity = queries[start : start + _BLOCK_ROWS] @ references.T
        rows = np.arange(len(similarity))
        top = similarity.argmax(1)
        block = slice(start, start + len(rows))
        index[block], best[block] = top, similarity[rows, top]
        similarity[rows, top] = -np.inf
        second[block] = similarity.max(1)
    distance = np.sqrt(np.maximum(2.0 - 2.0 * best.astype(np.float64), 0.0))
    next_distance = np.sqrt(np.maximum(2.0 - 2.0 * second.astype(np.float64), 0.0))
    ratio = np.divide(distance, next_distance, out=np.ones(num), where=next_distance > 0)
    return index, distance, ratio


def _described(features: Features) -> IndexArray:
    return np.flatnonzero(features.descriptors.any(1)).astype(np.int64)


def _best(candidates: IndexArray, cost: NDArray[np.float64], limit: int) -> IndexArray:
    if len(candidates) <= limit:
        return candidates
    order = np.argsort(cost[candidates], kind="stable")[:limit]
    return np.sort(candidates[order])
