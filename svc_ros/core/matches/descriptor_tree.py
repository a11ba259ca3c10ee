"""Nearest descriptors, exactly, without comparing all with all.

Most of what tells descriptors apart lies in a few directions. Along these, the head of a descriptor, rows are sorted
into small blocks with boxes around them; whole blocks whose boxes are too far away are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.kernels import descriptor as descriptor_kernels
from svc_ros.core.kernels.descriptor import HEAD, LANES
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import IndexArray

Descriptors = NDArray[np.float32]
Boxes = tuple[Descriptors, Descriptors]

_SAMPLE = 512  # rows that show the directions as well as all of them
_ROUNDS = 8  # of the search for the directions
_FIRST_CUT = 8  # blocks are cut off along the first direction in up to so many slabs, then in halves
_NOWHERE = 1e9  # where boxes stand that fill up the last group of them, farther than any distance asked for
_NO_PART = slice(0, 0)


@dataclass(frozen=True, eq=False)
class NearestRows:
    """The nearest row of each query, of equally near ones the first: index (Q,) and squared distance (Q,).

    sq_second: (Q,) squared distance of the second nearest, if asked for.
    """

    index: IndexArray
    sq_distance: Descriptors
    sq_second: Descriptors | None


@dataclass(frozen=True, eq=False)
class DescriptorTree:
    """Rows (R, D) of about unit length, sorted for nearest-neighbour queries.

    rows: (B, LANES, D) in blocks, some of them twice; directions: (D, HEAD) orthonormal; order: (B, LANES) indices of
    the rows; heads: (B, HEAD, LANES); boxes: around the heads of each block; outer_boxes: around LANES boxes each; both
    low and high edges, LANES side by side (_, HEAD, LANES).
    """

    rows: Descriptors
    directions: Descriptors
    order: IndexArray
    heads: Descriptors
    boxes: Boxes
    outer_boxes: Boxes

    @classmethod
    def build(cls, rows: Descriptors) -> DescriptorTree:
        """Sort at least one row (R, D)."""
        directions = find_directions(rows)
        heads = np.empty((len(rows), HEAD), np.float32)
        descriptor_kernels.fill_heads(rows, directions, heads)
        order = sort_into_blocks(heads)
        blocks = heads[order]
        boxes = _side_by_side(blocks.min(1), blocks.max(1))
        outer = _side_by_side(boxes[0].min(2), boxes[1].max(2))
        return cls(rows[order], directions, order, np.ascontiguousarray(blocks.swapaxes(1, 2)), boxes, outer)

    def find(self, queries: Descriptors, within: Descriptors | None = None, with_second: bool = False) -> NearestRows:
        """The nearest row for each of the queries (Q, D), on all processors.

        `within` (Q,): squared distances that are known not to be exceeded. Neither they nor the number of processors
        nor the order of the queries changes the answer.
        """
        num = len(queries)
        within = np.full(num, -1, np.float32) if within is None else within
        index, first, second = np.empty(num, np.int64), np.empty(num, np.float32), np.empty(num, np.float32)
        tree = (self.directions, self.rows, self.order, self.heads, *self.boxes, *self.outer_boxes)

        def find_part(part: slice) -> None:
            descriptor_kernels.find_nearest(
                queries[part], within[part], tree,
                index[part], first[part], second[part if with_second else _NO_PART],
            )  # fmt: skip

        on_all_processors(find_part, in_parts(num))
        return NearestRows(index, first, second if with_second else None)


def find_directions(rows: Descriptors) -> Descriptors:
    """Directions (D, HEAD) along which rows (R, D) differ most, nearly; zeros where there are fewer.

    They decide how fast nearest rows are found, not which. LAPACK is not used: its threads would spin on long after.
    """
    sample = rows[:: max(1, len(rows) // _SAMPLE)].astype(np.float64)
    directions = np.random.default_rng(0).normal(size=(HEAD, rows.shape[1]))
    descriptor_kernels.find_directions(sample - sample.mean(0), _ROUNDS, directions)
    return np.ascontiguousarray(directions.T, np.float32)


def sort_into_blocks(heads: Descriptors) -> IndexArray:
    """Indices (B, LANES) of heads (N, HEAD) that lie together, B a multiple of LANES; some twice, to fill it up."""
    num_blocks = -(-len(heads) // LANES)
    halvings = max(LANES.bit_length() - 1, (num_blocks // _FIRST_CUT).bit_length())
    slabs = -(-num_blocks >> halvings)
    rows = np.resize(np.arange(len(heads)), (slabs << halvings) * LANES)
    order: IndexArray = rows[np.argsort(heads[rows, 0], kind="stable")].reshape(slabs, -1)
    for _ in range(halvings):
        order = _halve(heads, order)
    return order


def _halve(heads: Descriptors, order: IndexArray) -> IndexArray:
    """Halve groups of indices (S, M), M even, where their heads spread most: (2 S, M / 2)."""
    grouped = heads[order]
    widest = grouped.var(1).argmax(1)
    along = np.take_along_axis(grouped, widest[:, None, None], 2)[:, :, 0]
    halves = np.argpartition(along, order.shape[1] // 2, axis=1)
    return np.take_along_axis(order, halves, 1).reshape(2 * len(order), -1)


def _side_by_side(low: Descriptors, high: Descriptors) -> Boxes:
    """Edges of N boxes, each (N, HEAD), in groups of LANES: two arrays (ceil(N / LANES), HEAD, LANES)."""
    fill = np.full((-len(low) % LANES, HEAD), _NOWHERE, np.float32)
    grouped = (np.concatenate([edges, fill]).reshape(-1, LANES, HEAD) for edges in (low, high))
    lows, highs = (np.ascontiguousarray(edges.swapaxes(1, 2)) for edges in grouped)
    return lows, highs
