"""Hot loops over a placed scan, compiled by numba; no GIL, no state. Twins in test/support/reference.py.

Points are placed a few at a time: what is known of them is used before it leaves the processor's cache.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.nearest import find_nearest
from svc_ros.core.kernels.plane import fill_rows, sum_up

_jit = kernel()

AT_ONCE = 256


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
def turned_dot(T, normal, x, y, z):  # type: ignore[no-untyped-def]
    """A normal (3,), turned by the pose T (4, 4), times (x, y, z)."""
    a, b, c = normal[0], normal[1], normal[2]
    u = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c
    v = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c
    return u * x + v * y + (T[2, 0] * a + T[2, 1] * b + T[2, 2] * c) * z


@_jit
def split(T, points, normals, own, own_normals, grid, limits, nearest, sums):  # type: ignore[no-untyped-def]
    """nearest (M,): the own point (N, 3) that each point (M, 3) lies on by the pose (4, 4), -1 if on none.

    grid: the tables of a NearestGrid of the own points; limits: (tolerance, smallest cosine of normals that face the
    same way). sums (10,), of the points that lie on something: their number; those whose surface faces the same way as
    the own, the opposite way; those of the same way within a quarter of the tolerance of the own plane; then xx, xy,
    xz, yy, yz, zz of the own normals, summed over those of the same way.
    """
    shape, spans, starts, blocks, block_names = grid
    placed = np.empty((AT_ONCE, 3))
    tolerance, min_cosine = limits[0], limits[1]
    near, opposed, same, tight = 0, 0, 0, 0
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for begin in range(0, points.shape[0], AT_ONCE):
        end = min(begin + AT_ONCE, points.shape[0])
        move(T, points[begin:end], placed)
        find_nearest(placed[: end - begin], tolerance, shape, spans, starts, blocks, block_names, nearest[begin:end])
        for m in range(end - begin):
            if nearest[begin + m] < 0:
                continue
            near += 1
            n = np.uint64(nearest[begin + m])  # an index that cannot be negative is quicker
            a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
            cosine = turned_dot(T, normals[begin + m], a, b, c)
            opposed += cosine < -min_cosine
            if cosine > min_cosine:
                same += 1
                x, y, z = placed[m, 0] - own[n, 0], placed[m, 1] - own[n, 1], placed[m, 2] - own[n, 2]
                tight += abs(x * a + y * b + z * c) < 0.25 * tolerance
                xx, xy, xz = xx + a * a, xy + a * b, xz + a * c
                yy, yz, zz = yy + b * b, yz + b * c, zz + c * c
    sums[0], sums[1], sums[2], sums[3] = near, same, opposed, tight
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = xx, xy, xz, yy, yz, zz


@_jit
def sum_contact(T, points, normals, nearest, own, own_normals, min_cosine, system):  # type: ignore[no-untyped-def]
    """Number of points (M, 3) that a pose (4, 4) puts on own surface which faces the same way; their squared residuals.

    nearest (M,): from split; system (6, 7): normal equations of their distances from the own planes, as in sum_up.
    """
    pairs, rows = np.empty((9, AT_ONCE)), np.empty((7, AT_ONCE))
    system[:] = 0.0
    count, squared = 0, 0.0
    for begin in range(0, points.shape[0], AT_ONCE):
        num = 0
        for m in range(begin, min(begin + AT_ONCE, points.shape[0])):
            if nearest[m] < 0:
                continue
            n = np.uint64(nearest[m])
            a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
            if turned_dot(T, normals[m], a, b, c) > min_cosine:
                for k in range(3):
                    pairs[k, num], pairs[3 + k, num], pairs[6 + k, num] = points[m, k], own[n, k], own_normals[n, k]
                num += 1
        fill_rows(T, pairs[:, :num], rows)
        squared += sum_up(rows[:, :num], system)
        count += num
    return count, squared
