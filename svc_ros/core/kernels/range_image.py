"""Hot loops of range images, compiled by numba; no GIL, no state. Twins in test/support/reference_images.py.

A direction's cell is looked up in two tables instead of by arc tangent and arc sine: the same for the points that fill
an image and for those that are held against it, so that both agree on every border.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.placement import turned_dot

_jit = kernel()


@_jit
def find_cell(x, y, z, rows, turns, columns, starts):  # type: ignore[no-untyped-def]
    """Cell of a direction (its length does not matter, but is not 0), -1 outside the image, and the length.

    rows: by (e + 1) / 2, where e = z / (|z| + the horizontal length) rises with the elevation from -1 to 1: the row or
    -1; turns: by quadrant and |y| / (|x| + |y|), the share of a turn in [0, 1); columns (R,), starts (R,): how many
    cells a row has, and where they begin.
    """
    a, b, c = abs(x), abs(y), abs(z)
    sq_flat = x * x + y * y
    length = np.sqrt(sq_flat + z * z)
    row = rows[int((z / (c + np.sqrt(sq_flat)) + 1.0) * (0.5 * (rows.shape[0] - 1)))]
    if row < 0:
        return -1, length
    flat = a + b
    k = int(b / flat * (turns.shape[1] - 1)) if flat > 0.0 else 0
    quadrant = (2 if y < 0.0 else 0) + (1 if x < 0.0 else 0)
    return starts[row] + int(turns[quadrant, k] * columns[row]), length


@_jit
def fill(points, origin, min_range, tables, near, far):  # type: ignore[no-untyped-def]
    """near, far (C,): least and greatest range [m] of the points (N, 3) of every cell; as they were where none is."""
    rows, turns, columns, starts = tables
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        if x * x + y * y + z * z <= min_range * min_range:
            continue
        cell, length = find_cell(x, y, z, rows, turns, columns, starts)
        if cell >= 0:
            near[cell] = min(near[cell], length)
            far[cell] = max(far[cell], length)


@_jit
def spread(near, far, columns, starts, least_held, wide_near, wide_far):  # type: ignore[no-untyped-def]
    """wide_near, wide_far (C,): least and greatest range over a cell and the eight around it.

    Both -1 where fewer than `least_held` of the nine hold a point, or none of the row above or below: a beam that was
    lost there may have met what now seems free. Columns go around; rows end at the image's border. Returns how many
    cells hold a point, how many of those have enough others around them, and how many are not -1.
    """
    num_rows, size, num_held, num_dense, num_seen = columns.shape[0], near.shape[0], 0, 0, 0
    row_near, row_far, row_held = np.empty(size, near.dtype), np.empty(size, near.dtype), np.empty(size, np.int8)
    for row in range(num_rows):
        begin, num = starts[row], columns[row]
        for col in range(num):
            left, right = begin + (col - 1 if col > 0 else num - 1), begin + (col + 1 if col < num - 1 else 0)
            mid = begin + col
            row_near[mid] = min(near[left], near[mid], near[right])
            row_far[mid] = max(far[left], far[mid], far[right])
            row_held[mid] = (far[left] > 0.0) + (far[mid] > 0.0) + (far[right] > 0.0)
    for row in range(num_rows):
        for col in range(columns[row]):
            mid = starts[row] + col
            low, high, held, rows_held = row_near[mid], row_far[mid], int(row_held[mid]), int(row_held[mid] > 0)
            for other in (row - 1, row + 1):
                if 0 <= other < num_rows:
                    k = starts[other] + ((2 * col + 1) * columns[other]) // (2 * columns[row])
                    low, high, held = min(low, row_near[k]), max(high, row_far[k]), held + row_held[k]
                    rows_held += row_held[k] > 0
            dense = held >= least_held
            seen = dense and rows_held == 3
            wide_near[mid], wide_far[mid] = (low, high) if seen else (-1.0, -1.0)
            if far[mid] > 0.0:
                num_held, num_dense, num_seen = num_held + 1, num_dense + int(dense), num_seen + int(seen)
    return num_held, num_dense, num_seen


@_jit
def look(T, points, normals, nearest, own_normals, origin, limits, image, denied):  # type: ignore[no-untyped-def]
    """How many points (M, 3) of another scan, placed by T (4, 4), the observer confirms, denies, has hidden, never saw.

    nearest (M,): the observer's point that each lies on, -1 if on none; own_normals (N, 3): of the observer's points;
    limits: (margin [m], margin as a share of the range, by which a point on none has to stand before the least range to
    be denied; smallest cosine of normals that face the same way, so that a point on one is confirmed); image: (near
    (C,), far (C,), tables) of a RangeImage; denied (M,): its first entries are the indices of the denied points.
    """
    near, far, (rows, turns, columns, starts) = image
    num_confirmed, num_denied, num_hidden, num_unseen = 0, 0, 0, 0
    for m in range(points.shape[0]):
        denied[num_denied] = m
        a, b, c = points[m, 0], points[m, 1], points[m, 2]
        x = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3] - origin[0]
        y = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3] - origin[1]
        z = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - origin[2]
        cell, length = -1, 0.0
        if x * x + y * y + z * z > 0.0:  # a point nearer than squares can tell has no direction
            cell, length = find_cell(x, y, z, rows, turns, columns, starts)
        if cell < 0 or far[cell] <= 0.0:
            num_unseen += 1
        elif nearest[m] >= 0:
            n = np.uint64(nearest[m])  # an index that cannot be negative is quicker
            cosine = turned_dot(T, normals[m], own_normals[n, 0], own_normals[n, 1], own_normals[n, 2])
            num_confirmed += cosine > limits[2]
        else:
            num_denied += near[cell] - length > limits[0] + limits[1] * length
            num_hidden += length > far[cell]
    return num_confirmed, num_denied, num_hidden, num_unseen
