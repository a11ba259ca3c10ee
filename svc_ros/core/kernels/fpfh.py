"""Fast point feature histograms (Rusu et al. 2009), compiled by numba; no GIL. Twins: test/support/reference.py.

Points and grids as in surface_kernels. Neighbours are looked at _LANES at a time, side by side in one flat buffer of
rows of _LANES, so that the geometry of the pairs runs in vector registers.
"""

from __future__ import annotations

import math

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.surface import find_surroundings

BINS = 11
_LANES, _ROWS = 64, 9

_jit = kernel(fastmath={"nnan", "ninf", "nsz", "contract"})

_ZERO, _ONE, _TINY = np.float32(0), np.float32(1), np.float32(1e-20)
_MIDDLE, _HALF, _LAST = np.float32(BINS // 2), np.float32(0.5 * BINS), np.float32(BINS - 0.5)
# Angles at which the upper half of the circle changes its bin, as directions.
_COS = tuple(np.float32(math.cos((2 * k + 1) * math.pi / BINS)) for k in range(BINS // 2))
_SIN = tuple(np.float32(math.sin((2 * k + 1) * math.pi / BINS)) for k in range(BINS // 2))


@_jit
def fill_own_histograms(begin, end, radius, most, grid, normals, histograms):  # type: ignore[no-untyped-def]
    """histograms (N, 3 BINS) float32 of points begin..end-1: how their normal stands to those around, each sums to 100.

    normals (N, 3) float32. Returns ends (end - begin,), neighbours (P,) and weights (P,), one over the squared
    distance (zero at no distance): what mix_histograms needs.
    """
    points = grid[1]
    found, squared = np.empty(len(points) + 1, np.int64), np.empty(len(points) + 1)
    ends = np.empty(end - begin, np.int64)
    neighbours, weights = np.empty((end - begin) * most, np.int32), np.empty((end - begin) * most, np.float32)
    buffer = np.empty(_ROWS * _LANES, np.float32)
    total = 0
    for i in range(begin, end):
        num = find_surroundings(i, radius, most, grid, found, squared)
        histograms[i] = _ZERO
        for first in range(0, num, _LANES):
            _count_pairs(points, normals, i, found[first : min(first + _LANES, num)], buffer, histograms[i])
        if num:
            scale = np.float32(100) / np.float32(num)
            for b in range(3 * BINS):
                histograms[i, b] *= scale
        for k in range(num):
            neighbours[total + k] = found[k]
            weights[total + k] = 1.0 / squared[k] if squared[k] > 0 else 0.0
        total += num
        ends[i - begin] = total
    return ends, neighbours[:total].copy(), weights[:total].copy()


@_jit
def _count_pairs(points, normals, i, neighbours, buffer, histogram):  # type: ignore[no-untyped-def]
    num = len(neighbours)
    for k in range(num):
        j = neighbours[k]
        for axis in range(3):
            buffer[axis * _LANES + k] = points[j, axis] - points[i, axis]
            buffer[(3 + axis) * _LANES + k] = normals[j, axis]
    _find_bins(buffer, normals[i, 0], normals[i, 1], normals[i, 2], num)
    for k in range(num):
        for row in range(6, _ROWS):
            histogram[int(buffer[row * _LANES + k])] += _ONE


@_jit
def _find_bins(buffer, nx, ny, nz, num):  # type: ignore[no-untyped-def]
    """From offsets (rows 0-2) and normals (rows 3-5) of `num` neighbours to their three bins (rows 6-8).

    The frame of a pair stands on the normal that is nearer to the line between the points, as in PCL and Open3D.
    """
    for k in range(num):
        dx, dy, dz = buffer[k], buffer[_LANES + k], buffer[2 * _LANES + k]
        mx, my, mz = buffer[3 * _LANES + k], buffer[4 * _LANES + k], buffer[5 * _LANES + k]
        here, there = nx * dx + ny * dy + nz * dz, mx * dx + my * dy + mz * dz
        swap = abs(here) < abs(there)
        sign = -_ONE if swap else _ONE
        ux, uy, uz = mx if swap else nx, my if swap else ny, mz if swap else nz
        tx, ty, tz = nx if swap else mx, ny if swap else my, nz if swap else mz
        vx, vy, vz = sign * (dy * uz - dz * uy), sign * (dz * ux - dx * uz), sign * (dx * uy - dy * ux)
        squared = vx * vx + vy * vy + vz * vz
        known = squared > _TINY  # else the pair has no frame; it counts as if nothing were tilted
        scale = _ONE / np.sqrt(squared) if known else _ZERO
        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        across = scale * (wx * tx + wy * ty + wz * tz)
        along = ux * tx + uy * ty + uz * tz if known else _ONE
        tilt = scale * (vx * tx + vy * ty + vz * tz)
        lean = (-there if swap else here) / np.sqrt(dx * dx + dy * dy + dz * dz) if known else _ZERO
        buffer[6 * _LANES + k] = _bin_of_angle(across, along)
        buffer[7 * _LANES + k] = min(max(_HALF * tilt + _HALF, _ZERO), _LAST) + np.float32(BINS)
        buffer[8 * _LANES + k] = min(max(_HALF * lean + _HALF, _ZERO), _LAST) + np.float32(2 * BINS)


@_jit
def _bin_of_angle(y, x):  # type: ignore[no-untyped-def]
    """Bin of the angle of (x, y), counted from -pi: how many borders lie between it and zero, by cross products."""
    size, steps = abs(y), _ZERO
    for k in range(BINS // 2):
        steps += _ONE if _COS[k] * size >= _SIN[k] * x else _ZERO
    return _MIDDLE + steps if y >= _ZERO else _MIDDLE - steps


@_jit
def mix_histograms(begin, ends, neighbours, weights, histograms, order, descriptors):  # type: ignore[no-untyped-def]
    """descriptors (N, 3 BINS), unit rows in the original order: a point's own histogram and the mean of those around.

    `begin`, ends, neighbours, weights as fill_own_histograms took and returned them.
    """
    mixed = np.empty(3 * BINS, np.float32)
    start = 0
    for k in range(len(ends)):
        mixed[:] = _ZERO
        for n in range(start, ends[k]):
            other, weight = histograms[neighbours[n]], weights[n]
            for b in range(3 * BINS):
                mixed[b] += weight * other[b]
        start = ends[k]
        _finish(mixed, histograms[begin + k], descriptors[order[begin + k]])


@_jit
def _finish(mixed, own, descriptor):  # type: ignore[no-untyped-def]
    squared = _ZERO
    for first in range(0, 3 * BINS, BINS):
        total = mixed[first : first + BINS].sum()
        scale = np.float32(100) / total if total > _ZERO else _ZERO
        for b in range(first, first + BINS):
            descriptor[b] = scale * mixed[b] + own[b]
            squared += descriptor[b] * descriptor[b]
    descriptor *= _ONE / np.sqrt(squared) if squared > _ZERO else _ZERO
