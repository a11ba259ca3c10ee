"""Hot loops of the nearest-neighbour search in a placed scan, compiled by numba; no GIL, no state.

Cells stand in columns along z. The points of three cells above each other follow one another in memory, so a query
reads at most nine short runs. Twins in test/reference.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True)

_AROUND = np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [-1, 1], [1, -1], [1, 1]], np.int64)


@_jit
def fill_columns(columns, levels, column_low, column_first):  # type: ignore[no-untyped-def]
    """Extent of every column, from the column and level of each point, sorted by column, then level.

    column_low (C,): its lowest level; column_first (C + 1,): its first cell, the number of all cells at the end.
    """
    column_first[:] = 0
    for i in range(columns.shape[0]):
        c = columns[i]
        if i == 0 or columns[i - 1] != c:
            column_low[c] = levels[i]
        column_first[c + 1] = levels[i] - column_low[c] + 1
    for c in range(column_low.shape[0]):
        column_first[c + 1] += column_first[c]


@_jit
def fill_cells(columns, levels, column_low, column_first, starts):  # type: ignore[no-untyped-def]
    """starts (cells + 1,): first point of every cell."""
    starts[:] = 0
    for i in range(columns.shape[0]):
        starts[column_first[columns[i]] + levels[i] - column_low[columns[i]] + 1] += 1
    for cell in range(starts.shape[0] - 1):
        starts[cell + 1] += starts[cell]


@_jit
def nearest_point(x, y, z, radius, shape, points, order, column_low, column_first, starts):  # type: ignore[no-untyped-def]
    """Index of the nearest point nearer than the radius, ties to the smaller index, -1 if there is none.

    shape: (x, y, z of the grid's corner, edge of a cell, columns along x, columns along y), the edge not below the
    radius; points: sorted by cell; order: their original indices.
    """
    edge, num_x, num_y = shape[3], int(shape[4]), int(shape[5])
    x_cell, y_cell = np.floor((x - shape[0]) / edge), np.floor((y - shape[1]) / edge)
    z_cell = np.floor((z - shape[2]) / edge)
    if not (-1 <= x_cell <= num_x and -1 <= y_cell <= num_y and abs(z_cell) < 1e9):
        return -1
    x_in, y_in = x - (shape[0] + x_cell * edge), y - (shape[1] + y_cell * edge)
    i, j, k = int(x_cell), int(y_cell), int(z_cell)
    best, found = radius * radius, -1
    for step in range(9):
        a, b = _AROUND[step, 0], _AROUND[step, 1]
        if not (0 <= i + a < num_x and 0 <= j + b < num_y):
            continue
        gap_x = 0.0 if a == 0 else (x_in if a < 0 else edge - x_in)
        gap_y = 0.0 if b == 0 else (y_in if b < 0 else edge - y_in)
        if gap_x * gap_x + gap_y * gap_y > best * (1.0 + 1e-9) + 1e-12:
            continue
        column = (i + a) * num_y + j + b
        first, last = column_first[column], column_first[column + 1] - 1
        base = first + k - column_low[column]
        low, high = max(base - 1, first), min(base + 1, last)
        if low > high:
            continue
        for n in range(starts[low], starts[high + 1]):
            dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
            sq = dx * dx + dy * dy + dz * dz
            if sq < best or (sq == best and found >= 0 and order[n] < found):
                best, found = sq, order[n]
    return found


@_jit
def find_nearest(queries, radius, shape, points, order, column_low, column_first, starts, nearest):  # type: ignore[no-untyped-def]
    """nearest (M,): what nearest_point says of each query (M, 3)."""
    for m in range(queries.shape[0]):
        nearest[m] = nearest_point(
            queries[m, 0], queries[m, 1], queries[m, 2],
            radius, shape, points, order, column_low, column_first, starts,
        )  # fmt: skip


@_jit
def turn(R, x, y, z):  # type: ignore[no-untyped-def]
    """A vector turned by the upper left of a pose (4, 4)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@_jit
def meet(T, other, other_normals, own, own_normals, limits, shape, points, order, column_low, column_first, starts, placed, turned, nearest, sums):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Place the other scan's points and normals (M, 3) by T (4, 4) and find the own point that each lies on.

    limits: (radius, cosine above which two surfaces face the same way); sums (10,): of the placed points those that
    lie on one, those that face the same way, the opposite way, those within a quarter of the radius of the own plane;
    then xx, xy, xz, yy, yz, zz of the planes' normals, summed over those that face the same way.
    """
    radius, min_cosine = limits[0], limits[1]
    sums[:] = 0.0
    for m in range(other.shape[0]):
        x, y, z = turn(T, other[m, 0], other[m, 1], other[m, 2])
        x, y, z = x + T[0, 3], y + T[1, 3], z + T[2, 3]
        nx, ny, nz = turn(T, other_normals[m, 0], other_normals[m, 1], other_normals[m, 2])
        placed[m, 0], placed[m, 1], placed[m, 2] = x, y, z
        turned[m, 0], turned[m, 1], turned[m, 2] = nx, ny, nz
        n = nearest_point(x, y, z, radius, shape, points, order, column_low, column_first, starts)
        nearest[m] = n
        if n < 0:
            continue
        sums[0] += 1.0
        a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
        cosine = nx * a + ny * b + nz * c
        if cosine < -min_cosine:
            sums[2] += 1.0
        elif cosine > min_cosine:
            sums[1] += 1.0
            if abs((x - own[n, 0]) * a + (y - own[n, 1]) * b + (z - own[n, 2]) * c) < 0.25 * radius:
                sums[3] += 1.0
            sums[4] += a * a
            sums[5] += a * b
            sums[6] += a * c
            sums[7] += b * b
            sums[8] += b * c
            sums[9] += c * c
