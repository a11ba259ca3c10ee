"""Hot loops over all raw points of a scan, compiled by numba; no GIL. Twins: test/core/scans/test_preprocess.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()

FRACTION_STEPS = 2.0**32  # a point's place inside its voxel, in steps of a nanometre or less
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST_BITS = 12  # of the table of cells, which grows


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
def _find_slot(keys, key, bits):  # type: ignore[no-untyped-def]
    """Where a key stands in a table of 2^bits keys, or the free place (-1) that is meant for it."""
    mask = (1 << bits) - 1
    slot = np.int64((np.uint64(key) * _GOLDEN) >> np.uint64(64 - bits))
    while keys[slot] != key and keys[slot] >= 0:
        slot = (slot + 1) & mask
    return slot


@_jit
def _longer_table(keys, numbers, bits):  # type: ignore[no-untyped-def]
    """The same keys and numbers in a table of 2^bits places."""
    longer_keys, longer_numbers = np.full(1 << bits, -1, np.int64), np.empty(1 << bits, np.int64)
    for k in range(len(keys)):
        if keys[k] >= 0:
            slot = _find_slot(longer_keys, keys[k], bits)
            longer_keys[slot], longer_numbers[slot] = keys[k], numbers[k]
    return longer_keys, longer_numbers


@_jit
def sum_in_cells(points, corner, edge, extent, cells, fractions, counts):  # type: ignore[no-untyped-def]
    """Number C of occupied cells of a grid from `corner`, `extent` (3,) cells along each axis, in order of appearance.

    Fills the first C rows of cells (N, 3), of fractions (N, 3), sums of the points' places inside their cell in steps
    of 2^-32 of its edge (whole numbers, so that their order does not matter), and of counts (N,).
    """
    bits = _FIRST_BITS
    keys, numbers = np.full(1 << bits, -1, np.int64), np.empty(1 << bits, np.int64)
    num, cell, last = 0, 0, -1
    for i in range(len(points)):
        if 2 * num >= 1 << bits:  # by cells, not by points: the table of a dense cloud stays in the cache
            bits += 2
            keys, numbers = _longer_table(keys, numbers, bits)
        x, y, z = (
            (points[i, 0] - corner[0]) / edge,
            (points[i, 1] - corner[1]) / edge,
            (points[i, 2] - corner[2]) / edge,
        )
        a, b, c = np.floor(x), np.floor(y), np.floor(z)
        key = (np.int64(a) * extent[1] + np.int64(b)) * extent[2] + np.int64(c)
        if key != last:  # what was measured one after the other lies in one cell often
            slot = _find_slot(keys, key, bits)
            if keys[slot] < 0:
                keys[slot], numbers[slot] = key, num
                cells[num, 0], cells[num, 1], cells[num, 2] = a, b, c
                fractions[num], counts[num] = 0, 0
                num += 1
            last, cell = key, numbers[slot]
        fractions[cell, 0] += np.int64(np.rint((x - a) * FRACTION_STEPS))
        fractions[cell, 1] += np.int64(np.rint((y - b) * FRACTION_STEPS))
        fractions[cell, 2] += np.int64(np.rint((z - c) * FRACTION_STEPS))
        counts[cell] += 1
    return num


@_jit
def fill_elevations(points, origin, sector_deg, every, maybe, keys):  # type: ignore[no-untyped-def]
    """Number of points in every so many-th azimuth sector; keys (N,): 1024 times its sector plus elevation [deg].

    maybe: by quadrant and |y| / (|x| + |y|), whether a point may lie in one of those sectors; it spares most points
    the arc tangent.
    """
    num = 0
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        flat = abs(x) + abs(y)
        quadrant = (2 if y < 0.0 else 0) + (1 if x < 0.0 else 0)
        if flat > 0.0 and not maybe[quadrant, int(abs(y) / flat * (maybe.shape[1] - 1))]:
            continue
        sector = np.floor(np.degrees(np.arctan2(y, x)) / sector_deg)
        if sector % every == 0:
            keys[num] = 1024.0 * sector + np.degrees(np.arctan2(z, np.sqrt(x * x + y * y)))
            num += 1
    return num
