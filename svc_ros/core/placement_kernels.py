"""Hot loops over a placed scan, compiled by numba; no GIL, no state. Twins in test/reference.py.

Points are placed a few at a time: what is known of them is used before it leaves the processor's cache.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from svc_ros.core.nearest_kernels import find_nearest

_jit = njit(nogil=True, cache=True, error_model="numpy")

_AT_ONCE = 256


@_jit
def move(T, points, placed):  # type: ignore[no-untyped-def]
    """placed (M, 3): points (M, 3) as the pose T (4, 4) moves them."""
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        for k in range(3):
            placed[m, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]


@_jit
def place(T, points, normals, placed, turned):  # type: ignore[no-untyped-def]
    """placed, turned (M, 3): points and normals (M, 3) as the pose T (4, 4) moves them."""
    move(T, points, placed)
    for m in range(points.shape[0]):
        a, b, c = normals[m, 0], normals[m, 1], normals[m, 2]
        for k in range(3):
            turned[m, k] = T[k, 0] * a + T[k, 1] * b + T[k, 2] * c


@_jit
def split(T, points, normals, own, own_normals, grid, limits, alone, alone_normals, names, sums):  # type: ignore[no-untyped-def]  # fmt: skip
    """Number A of points (M, 3) that a pose (4, 4) puts on no own point (N, 3) within the tolerance.

    The first A of alone, alone_normals (M, 3) and names (M,) become these, placed, and their indices. grid: the tables
    of a NearestGrid of the own points; limits: (tolerance, smallest cosine of normals that face the same way).
    sums (10,), of the other points: their number; those whose surface faces the same way as the own, the opposite way;
    those of the same way within a quarter of the tolerance of the own plane; then xx, xy, xz, yy, yz, zz of the own
    normals, summed over those of the same way.
    """
    shape, low, first, starts, blocks, block_names = grid
    placed, turned, nearest = np.empty((_AT_ONCE, 3)), np.empty((_AT_ONCE, 3)), np.empty(_AT_ONCE, np.int64)
    num_alone = 0
    sums[:] = 0.0
    for begin in range(0, points.shape[0], _AT_ONCE):
        num = min(_AT_ONCE, points.shape[0] - begin)
        place(T, points[begin : begin + num], normals[begin : begin + num], placed, turned)
        find_nearest(placed[:num], limits[0], shape, low, first, starts, blocks, block_names, nearest)
        for m in range(num):
            if nearest[m] < 0:
                for k in range(3):
                    alone[num_alone, k], alone_normals[num_alone, k] = placed[m, k], turned[m, k]
                names[num_alone] = begin + m
                num_alone += 1
        _sum_up(placed[:num], turned, nearest, own, own_normals, limits, sums)
    return num_alone


@_jit
def _sum_up(placed, turned, nearest, own, own_normals, limits, sums):  # type: ignore[no-untyped-def]
    for m in range(placed.shape[0]):
        n = nearest[m]
        if n < 0:
            continue
        sums[0] += 1.0
        a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
        cosine = turned[m, 0] * a + turned[m, 1] * b + turned[m, 2] * c
        if cosine < -limits[1]:
            sums[2] += 1.0
        elif cosine > limits[1]:
            sums[1] += 1.0
            x, y, z = placed[m, 0] - own[n, 0], placed[m, 1] - own[n, 1], placed[m, 2] - own[n, 2]
            sums[3] += abs(x * a + y * b + z * c) < 0.25 * limits[0]
            sums[4] += a * a
            sums[5] += a * b
            sums[6] += a * c
            sums[7] += b * b
            sums[8] += b * c
            sums[9] += c * c


@_jit
def pick_contact(T, points, normals, own, own_normals, grid, limits, touching, planes, residuals):  # type: ignore[no-untyped-def]  # fmt: skip
    """Number K of points (M, 3) that a pose (4, 4) puts on own surface which faces the same way.

    The first K of touching (M, 3), planes (M, 3) and residuals (M,) become these points, placed, the own normals under
    them and the distances from the own planes. The rest as in `split`.
    """
    shape, low, first, starts, blocks, block_names = grid
    placed, turned, nearest = np.empty((_AT_ONCE, 3)), np.empty((_AT_ONCE, 3)), np.empty(_AT_ONCE, np.int64)
    count = 0
    for begin in range(0, points.shape[0], _AT_ONCE):
        num = min(_AT_ONCE, points.shape[0] - begin)
        place(T, points[begin : begin + num], normals[begin : begin + num], placed, turned)
        find_nearest(placed[:num], limits[0], shape, low, first, starts, blocks, block_names, nearest)
        for m in range(num):
            n = nearest[m]
            if n < 0:
                continue
            a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
            if turned[m, 0] * a + turned[m, 1] * b + turned[m, 2] * c > limits[1]:
                x, y, z = placed[m, 0], placed[m, 1], placed[m, 2]
                touching[count, 0], touching[count, 1], touching[count, 2] = x, y, z
                planes[count, 0], planes[count, 1], planes[count, 2] = a, b, c
                residuals[count] = (x - own[n, 0]) * a + (y - own[n, 1]) * b + (z - own[n, 2]) * c
                count += 1
    return count
