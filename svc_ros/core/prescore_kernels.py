"""Hot loops of the cheap look at many poses, on hashed cells; no GIL, no state. Twins in test/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True)

_HASH_FACTOR = np.int64(-7046029254386353131)  # 2^64 / golden ratio, as a signed word
_AXIS_BITS = 21
_AXIS_OFFSET = 1 << 20


@_jit
def cell_key(x, y, z, inverse_edge):  # type: ignore[no-untyped-def]
    """Packed integer coordinates of the cell that holds a point (21 bits an axis)."""
    i = np.int64(np.floor(x * inverse_edge)) + _AXIS_OFFSET
    j = np.int64(np.floor(y * inverse_edge)) + _AXIS_OFFSET
    k = np.int64(np.floor(z * inverse_edge)) + _AXIS_OFFSET
    return (i << (2 * _AXIS_BITS)) + (j << _AXIS_BITS) + k  # a sum: neighbours stay neighbours beyond 21 bits


@_jit
def fill_keys(points, inverse_edge, keys):  # type: ignore[no-untyped-def]
    """keys (N,): packed cell of every point."""
    for i in range(points.shape[0]):
        keys[i] = cell_key(points[i, 0], points[i, 1], points[i, 2], inverse_edge)


@_jit
def sum_by_key(keys, values, table_keys, table_row, found, sums):  # type: ignore[no-untyped-def]
    """Give every distinct key a row, in the order in which they come, and add up its values; return how many.

    keys (N,); values (N, 3); table_keys, table_row (a power of two, more than there are distinct keys): open
    addressing from a key to its row, empty slots hold row = -1; found: the key of every row; sums (_, 3).
    """
    mask = table_keys.shape[0] - 1
    table_row[:] = -1
    num = 0
    for i in range(keys.shape[0]):
        slot = ((keys[i] * _HASH_FACTOR) >> 32) & mask
        while table_row[slot] >= 0 and table_keys[slot] != keys[i]:
            slot = (slot + 1) & mask
        row = table_row[slot]
        if row < 0:
            row, num = num, num + 1
            table_keys[slot], table_row[slot], found[row] = keys[i], row, keys[i]
            sums[row] = 0.0
        for a in range(3):
            sums[row, a] += values[i, a]
    return num


@_jit
def count_agreeing(T, points, normals, table_keys, table_row, cell_normals, edge, min_cosine, agreeing):  # type: ignore[no-untyped-def]
    """agreeing (H,): points that each pose puts into an occupied cell whose normal agrees with the point's own."""
    mask = table_keys.shape[0] - 1
    inverse_edge = 1.0 / edge
    for h in range(T.shape[0]):
        R, count = T[h], 0
        for i in range(points.shape[0]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            key = cell_key(
                R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + R[0, 3],
                R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + R[1, 3],
                R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + R[2, 3],
                inverse_edge,
            )
            slot = ((key * _HASH_FACTOR) >> 32) & mask
            while table_row[slot] >= 0 and table_keys[slot] != key:
                slot = (slot + 1) & mask
            if table_row[slot] < 0:
                continue
            cosine = 0.0
            for a in range(3):
                turned = R[a, 0] * normals[i, 0] + R[a, 1] * normals[i, 1] + R[a, 2] * normals[i, 2]
                cosine += turned * cell_normals[table_row[slot], a]
            if cosine > min_cosine:
                count += 1
        agreeing[h] = count
