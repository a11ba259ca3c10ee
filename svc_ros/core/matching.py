"""Nearest descriptors become correspondences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import MatchingConfig
from svc_ros.core.scan import Array, Correspondences, Features, IndexArray

Descriptors = NDArray[np.float32]

# Products this small stay on one thread of the BLAS: the same bits whatever its number of threads, none of which spins
# while other programs need the processor. Together they still run at the speed of a large product.
_ROWS, _MAX_MULTIPLICATIONS = 64, 256_000
_PANELS = 64  # of references, compared at a time: 2 MB of similarities, looked at before they leave the cache


def match(source: Features, target: Features, config: MatchingConfig) -> Correspondences:
    """Match every source descriptor to its nearest target descriptor.

    one_way keeps them all; mutual keeps those that are nearest in both directions; ratio keeps the mutual ones and
    ranks them by nearest over second nearest distance. The best `max_correspondences` are returned, in source order.
    """
    source_idx, target_idx = _described(source), _described(target)
    a, b = source.descriptors[source_idx], target.descriptors[target_idx]
    nearest = find_nearest(a, b, with_ratio=config.strategy == "ratio")
    keep = np.arange(len(nearest.index)) if config.strategy == "one_way" else nearest.mutual()
    rank_by = nearest.distance if nearest.ratio is None else nearest.ratio
    chosen = _best(keep, rank_by, config.max_correspondences)
    return Correspondences(
        source.keypoints[source_idx[chosen]], target.keypoints[target_idx[nearest.index[chosen]]], rank_by[chosen]
    )


@dataclass(frozen=True, eq=False)
class NearestReferences:
    """The nearest of R references for each of Q queries; of equally near ones the first.

    index: (Q,); distance: (Q,) of unit vectors; back: (R,) the nearest query of each reference;
    ratio: (Q,) nearest over second nearest distance, if asked for.
    """

    index: IndexArray
    distance: Array
    back: IndexArray
    ratio: Array | None

    def mutual(self) -> IndexArray:
        """Queries that are the nearest of their nearest, ascending."""
        return np.flatnonzero(self.back[self.index] == np.arange(len(self.index)))


def find_nearest(queries: Descriptors, references: Descriptors, with_ratio: bool = False) -> NearestReferences:
    """Compare all unit-length queries (Q, D) with all references (R, D), each pair once."""
    panels = _split_into_panels(references)
    num, width = (len(queries) if len(references) else 0), panels.shape[2]
    padding = panels.shape[0] * width - len(references)
    rows, columns = _Running.empty(num), _Running.empty(len(panels) * width)
    for start in range(0, num, _ROWS):
        block = queries[start : start + _ROWS]
        for left in range(0, len(panels), _PANELS):
            similarity = block @ panels[left : left + _PANELS]
            if padding and left + len(similarity) == len(panels):
                similarity[-1, :, -padding:] = -np.inf
            columns.take_columns(similarity, left * width, start)
            rows.take_rows(similarity, start, left * width, with_ratio)
    distance = _distance(rows.best)
    ratio = _ratio(distance, _distance(rows.second)) if with_ratio else None
    return NearestReferences(rows.index, distance, columns.index[: len(references)], ratio)


@dataclass(frozen=True, eq=False)
class _Running:
    """The largest similarity of each row (or column) so far, where it is, and the second largest."""

    best: Descriptors
    second: Descriptors
    index: IndexArray

    @classmethod
    def empty(cls, num: int) -> _Running:
        best, second = (np.full(num, -np.inf, np.float32) for _ in range(2))
        return cls(best, second, np.zeros(num, np.int64))

    def take_columns(self, similarity: Descriptors, first: int, first_row: int) -> None:
        """Look at panels of similarities (P, rows, width) whose columns start at `first`."""
        top = similarity.max(1).ravel()
        better = np.flatnonzero(top > self.best[first : first + len(top)])  # ever fewer: their argmax costs little
        panel, column = np.divmod(better, similarity.shape[2])
        self.index[first + better] = first_row + similarity[panel, :, column].argmax(1)
        self.best[first + better] = top[better]

    def take_rows(self, similarity: Descriptors, first: int, first_column: int, with_second: bool) -> None:
        """Look at panels of similarities (P, rows, width) whose rows start at `first`."""
        rows, own = np.arange(similarity.shape[1]), slice(first, first + similarity.shape[1])
        top_of_panel = similarity.max(2)
        panel = top_of_panel.argmax(0)
        line = similarity[panel, rows]
        column = line.argmax(1)
        top = line[rows, column]
        if with_second:
            line[rows, column], top_of_panel[panel, rows] = -np.inf, -np.inf
            candidates = (self.second[own], np.minimum(self.best[own], top), line.max(1), top_of_panel.max(0))
            self.second[own] = np.max(candidates, axis=0)
        better = top > self.best[own]
        self.index[own][better] = (first_column + panel * similarity.shape[2] + column)[better]
        self.best[own][better] = top[better]


def _split_into_panels(references: Descriptors) -> Descriptors:
    """References (R, D) as matrices (P, D, width), the last one filled up with zeros."""
    num, length = references.shape
    width = max(8, _MAX_MULTIPLICATIONS // (_ROWS * max(length, 1)) // 8 * 8)
    padded = np.zeros((-(-num // width) * width, length), np.float32)
    padded[:num] = references
    return np.ascontiguousarray(padded.reshape(-1, width, length).swapaxes(1, 2))


def _distance(similarity: Descriptors) -> Array:
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * similarity.astype(np.float64), 0.0)))


def _ratio(distance: Array, next_distance: Array) -> Array:
    return np.divide(distance, next_distance, out=np.ones(len(distance)), where=next_distance > 0)


def _described(features: Features) -> IndexArray:
    return np.flatnonzero(features.descriptors.any(1)).astype(np.int64)


def _best(candidates: IndexArray, cost: Array, limit: int) -> IndexArray:
    if len(candidates) <= limit:
        return candidates
    order = np.argsort(cost[candidates], kind="stable")[:limit]
    return np.sort(candidates[order])
