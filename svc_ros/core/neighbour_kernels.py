"""Hot loops of the nearest-neighbour search in a placed scan, compiled by numba; no GIL, no state.

Cells stand in columns along z. The points of three cells above each other follow one another in memory, so a query
reads at most nine short runs. Twins in test/reference.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True, error_model="numpy")

_SLACK = 1e-9  # [m^2] rounding may put a point into the cell beside its own
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
def find_nearest(queries, radius, shape, points, order, column_low, column_first, starts, nearest):  # type: ignore[no-untyped-def]
    """nearest (M,): index of the point nearest to each query and nearer than the radius, ties to the smaller, or -1.

    shape: (x, y, z of the grid's corner, edge of a cell, columns along x, columns along y), the edge not below the
    radius; points: sorted by cell; order: their original indices.
    """
    edge, inverse, num_x, num_y = shape[3], 1.0 / shape[3], int(shape[4]), int(shape[5])
    for m in range(queries.shape[0]):
        nearest[m] = -1
        x, y, z = queries[m, 0], queries[m, 1], queries[m, 2]
        u, v, w = (x - shape[0]) * inverse + 1.0, (y - shape[1]) * inverse + 1.0, (z - shape[2]) * inverse
        if not (0.0 <= u < num_x + 2.0 and 0.0 <= v < num_y + 2.0 and abs(w) < 1e9):
            continue
        i, j, k = int(u) - 1, int(v) - 1, int(np.floor(w))
        x_in, y_in, z_in = (u - 1.0 - i) * edge, (v - 1.0 - j) * edge, (w - k) * edge
        left, right = x_in * x_in - _SLACK, (edge - x_in) ** 2 - _SLACK
        back, front = y_in * y_in - _SLACK, (edge - y_in) ** 2 - _SLACK
        below, above = z_in * z_in - _SLACK, (edge - z_in) ** 2 - _SLACK
        best, found = radius * radius, -1
        for step in range(9):
            a, b = _AROUND[step, 0], _AROUND[step, 1]
            gap = (0.0 if a == 0 else (left if a < 0 else right)) + (0.0 if b == 0 else (back if b < 0 else front))
            if gap > best or not (0 <= i + a < num_x and 0 <= j + b < num_y):
                continue
            column = (i + a) * num_y + j + b
            first, last = column_first[column], column_first[column + 1] - 1
            if first > last:
                continue
            level = first + k - column_low[column]
            low = max(level - 1 if gap + below <= best else level, first)
            high = min(level + 1 if gap + above <= best else level, last)
            if low > high:
                continue
            for n in range(starts[low], starts[high + 1]):
                dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
                sq = dx * dx + dy * dy + dz * dz
                if sq < best or (sq == best and found >= 0 and order[n] < found):
                    best, found = sq, order[n]
        nearest[m] = found


@_jit
def place(T, points, normals, placed, turned):  # type: ignore[no-untyped-def]
    """placed, turned (M, 3): points and normals (M, 3) as the pose T (4, 4) moves them."""
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        a, b, c = normals[m, 0], normals[m, 1], normals[m, 2]
        for k in range(3):
            placed[m, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]
            turned[m, k] = T[k, 0] * a + T[k, 1] * b + T[k, 2] * c


@_jit
def sum_up(placed, turned, nearest, own, own_normals, tolerance, min_cosine, sums):  # type: ignore[no-untyped-def]
    """sums (10,): of the placed points (M, 3) those that lie on an own point, nearest (M,) >= 0; those of them whose
    surface faces the same way as there, the opposite way; those of the same way within a quarter of the tolerance of
    the own plane; then xx, xy, xz, yy, yz, zz of the planes' normals, summed over those that face the same way.
    """
    sums[:] = 0.0
    for m in range(placed.shape[0]):
        n = nearest[m]
        if n < 0:
            continue
        sums[0] += 1.0
        a, b, c = own_normals[n, 0], own_normals[n, 1], own_normals[n, 2]
        cosine = turned[m, 0] * a + turned[m, 1] * b + turned[m, 2] * c
        if cosine < -min_cosine:
            sums[2] += 1.0
        elif cosine > min_cosine:
            sums[1] += 1.0
            x, y, z = placed[m, 0] - own[n, 0], placed[m, 1] - own[n, 1], placed[m, 2] - own[n, 2]
            if abs(x * a + y * b + z * c) < 0.25 * tolerance:
                sums[3] += 1.0
            sums[4] += a * a
            sums[5] += a * b
            sums[6] += a * c
            sums[7] += b * b
            sums[8] += b * c
            sums[9] += c * c
