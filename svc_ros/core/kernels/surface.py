"""Hot loops over the surroundings of every point of a scan, compiled by numba; no GIL, no state.

Points come sorted as in a RadiusGrid and are spoken of by their place in it; grid: shape, points, column_low,
column_first and starts of one. Twins in test/support/reference.py.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()

_ZERO = np.int64(0)  # a plain 0 is a type of its own: what it is passed to, compiled twice
_DEGENERATE = 1e-20  # of scaled squares: these vectors have no direction


@_jit
def find_surroundings(i, radius, most, grid, found, squared):  # type: ignore[no-untyped-def]
    """Number of points nearer to point i than the radius (at most the grid's), itself left out.

    Fills the beginning of found (N + 1,) and of squared (N + 1,), their squared distances. If there are more than
    `most`, only the nearest are kept.
    """
    shape, points, column_low, column_first, starts = grid
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    num_x, num_y = int(shape[4]), int(shape[5])
    a, b = int((x - shape[0]) / shape[3]), int((y - shape[1]) / shape[3])
    level = int((z - shape[2]) / shape[3])
    num, limit = _ZERO, radius * radius
    for near_a in range(max(a - 1, 0), min(a + 2, num_x)):
        for near_b in range(max(b - 1, 0), min(b + 2, num_y)):
            column = near_a * num_y + near_b
            first, last = column_first[column], column_first[column + 1] - 1
            cell = first + level - column_low[column]
            low, high = max(cell - 1, first), min(cell + 1, last)
            if low > high:
                continue
            for j in range(starts[low], starts[high + 1]):
                dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                distance = dx * dx + dy * dy + dz * dz
                found[num], squared[num] = j, distance
                num += (distance < limit) & (j != i)
    return _keep_nearest(found, squared, num, most) if num > most else num


@_jit
def _keep_nearest(found, squared, num, most):  # type: ignore[no-untyped-def]
    """Move the `most` nearest of `num` to the beginning, of equally near ones the first."""
    if most == 0:
        return 0
    limit = _select(squared[:num].copy(), most - 1)
    surplus = most
    for k in range(num):
        surplus -= squared[k] < limit
    kept = 0
    for k in range(num):
        at_limit = squared[k] == limit
        if squared[k] < limit or (at_limit and surplus > 0):
            surplus -= at_limit
            found[kept], squared[kept] = found[k], squared[k]
            kept += 1
    return kept


@_jit
def _select(values, k):  # type: ignore[no-untyped-def]
    """What stands at place k of the values once sorted; they are reordered. numba's own takes seconds to compile."""
    low, high = 0, len(values) - 1
    while low < high:
        a, b, c = values[low], values[(low + high) >> 1], values[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]


@_jit
def fit_normals(begin, end, radius, most, grid, normals, known):  # type: ignore[no-untyped-def]
    """normals (N, 3): direction of least spread of points begin..end-1 and their surroundings; either side up.

    known (N,): False where fewer than three points or no plane are there; those normals are not filled.
    """
    points = grid[1]
    found, squared = np.empty(len(points) + 1, np.int64), np.empty(len(points) + 1)
    for i in range(begin, end):
        num = find_surroundings(i, radius, most, grid, found, squared)
        known[i] = num >= 2
        if known[i]:
            known[i] = _least_spread(_spread(points, i, found, num), normals[i])


@_jit
def _spread(points, i, found, num):  # type: ignore[no-untyped-def]
    """Covariance xx, xy, xz, yy, yz, zz of point i and those found, not divided by their number."""
    sx, sy, sz, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(num):
        j = found[k]
        x, y, z = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
        sx, sy, sz = sx + x, sy + y, sz + z
        xx, xy, xz, yy, yz, zz = xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z
    n = num + 1.0
    return xx - sx * sx / n, xy - sx * sy / n, xz - sx * sz / n, yy - sy * sy / n, yz - sy * sz / n, zz - sz * sz / n


@_jit
def _least_spread(matrix, direction):  # type: ignore[no-untyped-def]
    """Unit eigenvector (3,) of the smallest eigenvalue of a symmetric matrix xx, xy, xz, yy, yz, zz.

    False, and nothing filled, where all eigenvalues are the same. On a line, one of the directions across it.
    """
    scale = max(abs(matrix[0]), abs(matrix[3]), abs(matrix[5]))
    if scale == 0.0:
        return False
    xx, xy, xz = matrix[0] / scale, matrix[1] / scale, matrix[2] / scale
    yy, yz, zz = matrix[3] / scale, matrix[4] / scale, matrix[5] / scale
    least = _smallest_eigenvalue(xx, xy, xz, yy, yz, zz)
    xx, yy, zz = xx - least, yy - least, zz - least
    # The rows of what is left span the plane; the eigenvector is what stands on two of them, the least parallel ones.
    a = (xy * yz - xz * yy, xz * xy - xx * yz, xx * yy - xy * xy)
    b = (xy * zz - xz * yz, xz * xz - xx * zz, xx * yz - xy * xz)
    c = (yy * zz - yz * yz, yz * xz - xy * zz, xy * yz - yy * xz)
    if _fill_unit(_longest(a, b, c), direction):
        return True
    u, v, w = _longest((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    return _fill_unit(_longest((0.0, w, -v), (-w, 0.0, u), (v, -u, 0.0)), direction)


@_jit
def _smallest_eigenvalue(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if p == 0.0:
        return mean
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    angle = np.arccos(min(max(determinant / (2.0 * p * p * p), -1.0), 1.0)) / 3.0
    return mean + 2.0 * p * np.cos(angle + 2.0 * np.pi / 3.0)


@_jit
def _longest(a, b, c):  # type: ignore[no-untyped-def]
    lengths = a[0] ** 2 + a[1] ** 2 + a[2] ** 2, b[0] ** 2 + b[1] ** 2 + b[2] ** 2, c[0] ** 2 + c[1] ** 2 + c[2] ** 2
    if lengths[0] >= lengths[1] and lengths[0] >= lengths[2]:
        return a
    return b if lengths[1] >= lengths[2] else c


@_jit
def _fill_unit(vector, unit):  # type: ignore[no-untyped-def]
    squared = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
    if squared < _DEGENERATE:
        return False
    length = np.sqrt(squared)
    unit[0], unit[1], unit[2] = vector[0] / length, vector[1] / length, vector[2] / length
    return True
