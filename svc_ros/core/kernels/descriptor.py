"""The hot loop of descriptor matching, compiled by numba; no GIL, no state. Its twin is the full distance matrix.

Sixteen things lie side by side in a block (HEAD, LANES): the heads of points or the edges of boxes around heads, so
that a query is compared with all of them at once and the answer is a bit mask.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

HEAD, LANES = 8, 16

# Every distance comes out of the same instructions, so that equal rows are equally far, to the bit.
_jit = kernel(fastmath={"nnan", "ninf", "nsz", "contract", "reassoc"})

# No unit rows are so far apart, and the boxes that fill up a block are farther.
_ZERO, _ONE, _FAR = np.float32(0), np.uint32(1), np.float32(1e12)
_BIT_OF = np.zeros(37, np.int64)  # powers of two below 2^36 all differ modulo 37
_BIT_OF[[2**bit % 37 for bit in range(36)]] = np.arange(36)


@_jit
def find_nearest(queries, within, tree, index, first, second):  # type: ignore[no-untyped-def]
    """The nearest row of a tree for each of Q queries, of equally near ones the first, whatever the tree's shape.

    queries (Q, D); within (Q,): squared distance that the nearest does not exceed, negative where unknown; tree:
    directions (D, HEAD), rows (B, LANES, D) of its blocks, their indices (B, LANES) and heads (B, HEAD, LANES), low and
    high (B / LANES, HEAD, LANES) of the boxes around blocks, low and high (G, HEAD, LANES) of those around LANES boxes.
    Fills index (Q,), first (Q,) squared distance and, unless empty, second (Q,), that of the second nearest, for which
    `within` must be unknown.
    """
    directions, rows, order, heads, low, high, outer_low, outer_high = tree
    with_second, head = len(second) > 0, np.empty(HEAD, np.float32)
    for i in range(len(queries)):
        query = queries[i]
        _project(query, directions, head)
        limit = within[i] if within[i] >= 0 else _guess(query, head, tree, with_second)
        bound, best, next_best, nearest = _widen(limit), _FAR, _FAR, -1
        for outer in range(len(outer_low)):
            boxes = _boxes_within(head, outer_low[outer], outer_high[outer], bound)
            while boxes:
                box = LANES * outer + _lowest_bit(boxes)
                boxes &= boxes - _ONE
                blocks = _boxes_within(head, low[box], high[box], bound)
                while blocks:
                    block = LANES * box + _lowest_bit(blocks)
                    blocks &= blocks - _ONE
                    points = _points_within(head, heads[block], bound)
                    while points:
                        lane = _lowest_bit(points)
                        points &= points - _ONE
                        j, distance = order[block, lane], _squared_distance(query, rows[block, lane])
                        if distance < best or (distance == best and j < nearest):
                            best, next_best, nearest = distance, best, j
                        elif distance < next_best and j != nearest:  # a row may be in two blocks
                            next_best = distance
                        bound = min(bound, _widen(next_best if with_second else best))
        index[i], first[i] = nearest, best
        if with_second:
            second[i] = next_best


@_jit
def find_directions(sample, rounds, directions):  # type: ignore[no-untyped-def]
    """Turn directions (HEAD, D) towards those along which a centred sample (S, D) spreads most; all float64.

    Orthogonal iteration: they end orthonormal, or zero where the sample has no more directions.
    """
    turned, along = np.empty_like(directions), np.empty(HEAD)
    for _ in range(rounds):
        turned[:] = 0.0
        for row in sample:
            for b in range(HEAD):
                along[b] = _inner(row, directions[b])
            for b in range(HEAD):
                for k in range(len(row)):
                    turned[b, k] += along[b] * row[k]
        for b in range(HEAD):  # whole arrays bring along the message on shapes that differ, long to compile
            for k in range(directions.shape[1]):
                directions[b, k] = turned[b, k]
        _make_orthonormal(directions)


@_jit
def _make_orthonormal(vectors):  # type: ignore[no-untyped-def]
    for b in range(len(vectors)):
        vector, before = vectors[b], np.sqrt(_inner(vectors[b], vectors[b]))
        for _ in range(2):  # twice: the first time leaves rounding
            for earlier in range(b):
                vector -= _inner(vector, vectors[earlier]) * vectors[earlier]
        length = np.sqrt(_inner(vector, vector))
        if length > 1e-9 * before:
            vector /= length
        else:
            vector[:] = 0.0


@_jit
def _inner(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@_jit
def fill_heads(rows, directions, heads):  # type: ignore[no-untyped-def]
    """heads (N, HEAD) of rows (N, D) along directions (D, HEAD)."""
    for i in range(len(rows)):
        _project(rows[i], directions, heads[i])


@_jit
def _project(row, directions, head):  # type: ignore[no-untyped-def]
    head[:] = _ZERO
    for k in range(len(row)):
        for b in range(HEAD):
            head[b] += row[k] * directions[k, b]


@_jit
def _guess(query, head, tree, with_second):  # type: ignore[no-untyped-def]
    """Squared distance to the nearest (or second nearest) row of the block whose box is nearest."""
    _, rows, order, _, low, high, outer_low, outer_high = tree
    box, least = 0, _FAR
    for outer in range(len(outer_low)):
        lane, distance = _nearest_box(head, outer_low[outer], outer_high[outer])
        if distance < least:
            box, least = LANES * outer + lane, distance
    block = LANES * box + _nearest_box(head, low[box], high[box])[0]
    best, next_best, nearest = _FAR, _FAR, -1
    for lane in range(LANES):
        j = order[block, lane]
        distance = _squared_distance(query, rows[block, lane])
        if distance < best:
            best, next_best, nearest = distance, best, j
        elif distance < next_best and j != nearest:
            next_best = distance
    return next_best if with_second else best


@_jit
def _nearest_box(head, low, high):  # type: ignore[no-untyped-def]
    """Lane and squared distance of the nearest of LANES boxes."""
    nearest, least = 0, _FAR
    for lane in range(LANES):
        distance = _squared_distance_to_box(head, low, high, lane)
        if distance < least:
            nearest, least = lane, distance
    return nearest, least


@_jit
def _boxes_within(head, low, high, bound):  # type: ignore[no-untyped-def]
    """Bit mask of the boxes whose squared distance does not exceed the bound."""
    mask = np.uint32(0)
    for lane in range(LANES):
        mask |= np.uint32(_squared_distance_to_box(head, low, high, lane) <= bound) << np.uint32(lane)
    return mask


@_jit
def _squared_distance_to_box(head, low, high, lane):  # type: ignore[no-untyped-def]
    total = _ZERO
    for k in range(HEAD):
        outside = max(max(low[k, lane] - head[k], head[k] - high[k, lane]), _ZERO)
        total += outside * outside
    return total


@_jit
def _points_within(head, block, bound):  # type: ignore[no-untyped-def]
    """Bit mask of the points whose heads alone do not exceed the squared distance."""
    mask = np.uint32(0)
    for lane in range(LANES):
        total = _ZERO
        for k in range(HEAD):
            difference = head[k] - block[k, lane]
            total += difference * difference
        mask |= np.uint32(total <= bound) << np.uint32(lane)
    return mask


@_jit
def _squared_distance(a, b):  # type: ignore[no-untyped-def]
    total = _ZERO
    for k in range(len(a)):
        difference = a[k] - b[k]
        total += difference * difference
    return total


@_jit
def _widen(squared_distance):  # type: ignore[no-untyped-def]
    """Heads are rounded: what seems to lie beyond by less than this is looked at."""
    return squared_distance * np.float32(1 + 1e-4) + np.float32(1e-8)


@_jit
def _lowest_bit(mask):  # type: ignore[no-untyped-def]
    return _BIT_OF[np.uint32(mask & (~mask + _ONE)) % np.uint32(37)]
