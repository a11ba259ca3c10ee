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
def fill_hash(sorted_keys, table_keys, table_start, table_end):  # type: ignore[no-untyped-def]
    """Open-addressing table from a cell's key to its run in the sorted points; empty slots hold start = -1."""
    mask = table_keys.shape[0] - 1
    table_start[:] = -1
    i = 0
    n = sorted_keys.shape[0]
    while i < n:
        key = sorted_keys[i]
        end = i + 1
        while end < n and sorted_keys[end] == key:
            end += 1
        slot = ((key * _HASH_FACTOR) >> 32) & mask
        while table_start[slot] >= 0:
            slot = (slot + 1) & mask
        table_keys[slot], table_start[slot], table_end[slot] = key, i, end
        i = end


@_jit
def count_agreeing(T, points, normals, table_keys, table_start, cell_normals, edge, min_cosine, agreeing):  # type: ignore[no-untyped-def]
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
            while table_start[slot] >= 0 and table_keys[slot] != key:
                slot = (slot + 1) & mask
            if table_start[slot] < 0:
                continue
            cosine = 0.0
            for a in range(3):
                turned = R[a, 0] * normals[i, 0] + R[a, 1] * normals[i, 1] + R[a, 2] * normals[i, 2]
                cosine += turned * cell_normals[table_start[slot], a]
            if cosine > min_cosine:
                count += 1
        agreeing[h] = count
