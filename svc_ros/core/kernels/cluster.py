"""Hot loops that gather points into clusters, compiled by numba; no GIL. Twins: test/support/reference_images.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_REACH = np.int64(1) << 20  # cells each way from the first point: more than any scan holds


@_jit
def label(points, edge, labels):  # type: ignore[no-untyped-def]
    """labels (N,): the first point of the cluster that each point (N, 3) belongs to.

    Points belong together where their cells of a grid of that edge touch, by a corner or by others between them.
    """
    num = points.shape[0]
    bits = 4
    while (1 << bits) < 2 * num:
        bits += 1
    keys, first = np.full(1 << bits, -1, np.int64), np.empty(1 << bits, np.int64)
    cells = np.empty((num, 3), np.int64)
    for i in range(num):
        labels[i] = i
        for k in range(3):
            cells[i, k] = np.int64(np.floor((points[i, k] - points[0, k]) / edge))
        slot = _find(keys, cells[i, 0], cells[i, 1], cells[i, 2], bits)
        if keys[slot] < 0:
            keys[slot], first[slot] = _key(cells[i, 0], cells[i, 1], cells[i, 2]), i
        else:
            labels[i] = first[slot]
    for i in range(num):
        if labels[i] != i and first[_find(keys, cells[i, 0], cells[i, 1], cells[i, 2], bits)] != i:
            continue  # its cell was looked at with its first point
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    slot = _find(keys, cells[i, 0] + a, cells[i, 1] + b, cells[i, 2] + c, bits)
                    if keys[slot] >= 0:
                        _join(labels, i, first[slot])
    for i in range(num):
        labels[i] = _root(labels, i)


@_jit
def _key(a, b, c):  # type: ignore[no-untyped-def]
    return ((a + _REACH) * (2 * _REACH) + (b + _REACH)) * (2 * _REACH) + (c + _REACH)


@_jit
def _find(keys, a, b, c, bits):  # type: ignore[no-untyped-def]
    """Slot of a cell, or the empty one where it belongs."""
    key = _key(a, b, c)
    mask, slot = (1 << bits) - 1, np.int64((np.uint64(key) * _GOLDEN) >> np.uint64(64 - bits))
    while keys[slot] != key and keys[slot] >= 0:
        slot = (slot + 1) & mask
    return slot


@_jit
def _root(labels, i):  # type: ignore[no-untyped-def]
    while labels[i] != i:
        labels[i] = labels[labels[i]]
        i = labels[i]
    return i


@_jit
def _join(labels, i, j):  # type: ignore[no-untyped-def]
    """The smaller root names both."""
    a, b = _root(labels, i), _root(labels, j)
    labels[max(a, b)] = min(a, b)


@_jit
def sum_by_extent(points, labels, whole_angle):  # type: ignore[no-untyped-def]
    """Sum over clusters: number of points times the angle they extend over, seen from 0, 0, 0, in shares of the whole.

    A cluster of the whole angle [rad] or more counts fully. Extent: diagonal of its box over its mean distance.
    """
    num = points.shape[0]
    low, high = np.full((num, 3), np.inf), np.full((num, 3), -np.inf)
    counts, ranges = np.zeros(num, np.int64), np.zeros(num)
    for i in range(num):
        n = labels[i]
        counts[n] += 1
        ranges[n] += np.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2 + points[i, 2] ** 2)
        for k in range(3):
            low[n, k], high[n, k] = min(low[n, k], points[i, k]), max(high[n, k], points[i, k])
    total = 0.0
    for n in range(num):
        if counts[n] > 0:
            extent = 0.0
            for k in range(3):
                extent += (high[n, k] - low[n, k]) ** 2
            angle = np.sqrt(extent) * counts[n] / max(ranges[n], 1e-9)
            total += counts[n] * min(1.0, angle / whole_angle)
    return total
