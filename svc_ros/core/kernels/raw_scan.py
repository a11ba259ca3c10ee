"""Hot loops over all raw points of a scan, compiled by numba; no GIL. Twins: test/core/scans/test_preprocess.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()

FRACTION_STEPS = 2.0**32  # a point's place inside its voxel, in steps of a nanometre or less
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@_jit
def copy_in_range(points, origin, sq_low, sq_high, kept):  # type: ignore[no-untyped-def]
    """Number of points (N, 3) whose squared distance from the origin lies within the limits and is not zero.

    They are copied, in order, to the beginning of kept (N, 3).
    """
    num = 0
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        squared = x * x + y * y + z * z
        if sq_low <= squared <= sq_high and squared > 0:
            kept[num, 0], kept[num, 1], kept[num, 2] = points[i, 0], points[i, 1], points[i, 2]
            num += 1
    return num


@_jit
def sum_in_cells(points, corner, edge, extent, cells, fractions, counts):  # type: ignore[no-untyped-def]
    """Number C of occupied cells of a grid from `corner`, `extent` (3,) cells along each axis, in order of appearance.

    Fills the first C rows of cells (N, 3), of fractions (N, 3), sums of the points' places inside their cell in steps
    of 2^-32 of its edge (whole numbers, so that their order does not matter), and of counts (N,).
    """
    bits = 4
    while (1 << bits) < 2 * len(points):
        bits += 1
    mask, shift = (1 << bits) - 1, np.uint64(64 - bits)
    keys, numbers = np.full(1 << bits, -1, np.int64), np.empty(1 << bits, np.int64)
    num = 0
    for i in range(len(points)):
        x, y, z = (
            (points[i, 0] - corner[0]) / edge,
            (points[i, 1] - corner[1]) / edge,
            (points[i, 2] - corner[2]) / edge,
        )
        a, b, c = np.floor(x), np.floor(y), np.floor(z)
        key = (np.int64(a) * extent[1] + np.int64(b)) * extent[2] + np.int64(c)
        slot = np.int64((np.uint64(key) * _GOLDEN) >> shift)
        while keys[slot] != key and keys[slot] >= 0:
            slot = (slot + 1) & mask
        if keys[slot] < 0:
            keys[slot], numbers[slot] = key, num
            cells[num, 0], cells[num, 1], cells[num, 2] = a, b, c
            fractions[num], counts[num] = 0, 0
            num += 1
        cell = numbers[slot]
        fractions[cell, 0] += np.int64(np.rint((x - a) * FRACTION_STEPS))
        fractions[cell, 1] += np.int64(np.rint((y - b) * FRACTION_STEPS))
        fractions[cell, 2] += np.int64(np.rint((z - c) * FRACTION_STEPS))
        counts[cell] += 1
    return num


@_jit
def fill_elevations(points, origin, sector_deg, every, keys):  # type: ignore[no-untyped-def]
    """Number of points in every so many-th azimuth sector; keys (N,): 1024 times its sector plus elevation [deg]."""
    num = 0
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        sector = np.floor(np.degrees(np.arctan2(y, x)) / sector_deg)
        if sector % every == 0:
            keys[num] = 1024.0 * sector + np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))
            num += 1
    return num
