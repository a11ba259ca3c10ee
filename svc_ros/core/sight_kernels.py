"""Hot loops of the sight-line check, compiled by numba; no GIL, no state. Twins in test/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True, error_model="numpy")

_ROUNDING = 1e-6  # of a cell: so near to its border a direction is looked for on both sides


@_jit
def quarter_turns(x, y):  # type: ignore[no-untyped-def]
    """Grows with the azimuth of (x, y), one in each quarter from 0 to 4; no angle is computed."""
    size = abs(x) + abs(y)
    along = y / size if size > 0.0 else 0.0
    if x < 0.0:
        return 2.0 - along
    return along if along >= 0.0 else 4.0 + along


@_jit
def fill_direction_cells(points, rows, columns, cells):  # type: ignore[no-untyped-def]
    """cells (N,): row-major cell of each point's direction from the origin: by sine of its elevation, by azimuth."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        row = int((0.5 * z / np.sqrt(x * x + y * y + z * z) + 0.5) * rows)
        column = int(0.25 * quarter_turns(x, y) * columns)
        cells[i] = min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)


@_jit
def fill_lines(points, normals, order, lines):  # type: ignore[no-untyped-def]
    """lines (L, 8): end point, range, normal and tangent of the incidence angle of each sight line."""
    for i in range(order.shape[0]):
        x, y, z = points[order[i], 0], points[order[i], 1], points[order[i], 2]
        a, b, c = normals[order[i], 0], normals[order[i], 1], normals[order[i], 2]
        length = np.sqrt(x * x + y * y + z * z)
        cosine = abs(x * a + y * b + z * c) / length
        lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3] = x, y, z, length
        lines[i, 4], lines[i, 5], lines[i, 6] = a, b, c
        lines[i, 7] = np.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-9)


@_jit
def cells_around(x, y, z, sine, rows, columns):  # type: ignore[no-untyped-def]
    """First and last row, first and last column of the cells that hold all directions within an angle of (x, y, z).

    sine: of that angle, less than a right one. Columns go round: the last one may be beyond the number of columns.
    """
    flat = np.sqrt(x * x + y * y)
    length = np.sqrt(flat * flat + z * z)
    up, level, cosine = z / length, flat / length, np.sqrt(1.0 - sine * sine)
    low, high = up * cosine - level * sine, up * cosine + level * sine  # sines of the lowest and highest elevation
    column_from, column_to = 0, columns - 1
    if level > sine:
        aside = sine / level  # sine of the azimuth between the direction and the farthest ones around it
        ahead = np.sqrt(1.0 - aside * aside)
        first = quarter_turns(x * ahead + y * aside, y * ahead - x * aside)
        last = quarter_turns(x * ahead - y * aside, y * ahead + x * aside)
        column_from = int(np.floor(0.25 * first * columns - _ROUNDING))
        column_to = int(np.floor(0.25 * last * columns + _ROUNDING))
        if column_from < 0:
            column_from, column_to = column_from + columns, column_to + columns
        column_to += columns if column_to < column_from else 0
    elif z > 0.0:  # a pole, and so all azimuths, are among them
        high = 1.0
    else:
        low = -1.0
    row_from = max(int((0.5 * low + 0.5) * rows - _ROUNDING), 0)
    row_to = min(int((0.5 * high + 0.5) * rows + _ROUNDING), rows - 1)
    return row_from, row_to, column_from, min(column_to, column_from + columns - 1)


@_jit
def find_blockers(placed, turned, origin, limits, max_blocked, lines, order, cell_starts, rows, columns, blocker, blocker_range, observed):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Find the sight lines that end behind a point of the other scan; return how many.

    placed, turned (M, 3): those points of the other scan, with their normals, in the observer's frame that lie on
    nothing of the observer's own surface; origin (3,): the sensor;
    limits: (tolerance, beam radius, sine of the largest half angle, largest tangent of the incidence angle);
    max_blocked: the search ends as soon as more lines are blocked;
    lines (L, 8): as fill_lines leaves them, sorted by direction cell; order (L,): their names;
    blocker (N,): by the line's name, the nearest point that blocks it, or -1; blocker_range (N,): its range;
    observed (N,): whether any point that may block lies along the line.
    A point p blocks the line to q if the line passes within the beam radius of it, its range is smaller than q's by
    more than the tolerance plus what the surface at q may rise within that radius, and neither surface's tangent
    plane contains the other point within the tolerance.
    """
    tolerance, radius, max_sine, max_tangent = limits[0], limits[1], limits[2], limits[3]
    num_blocked = 0
    for m in range(placed.shape[0]):
        px, py, pz = placed[m, 0] - origin[0], placed[m, 1] - origin[1], placed[m, 2] - origin[2]
        flat = np.sqrt(px * px + py * py)
        sq_p = flat * flat + pz * pz
        p_range = np.sqrt(sq_p)
        if p_range <= radius:
            continue
        sq_limit = min(radius, p_range * max_sine) ** 2
        row_from, row_to, column_from, column_to = cells_around(px, py, pz, np.sqrt(sq_limit) / p_range, rows, columns)
        for row in range(row_from, row_to + 1):
            for part in range(2 if column_to >= columns else 1):
                first, last = (column_from, min(column_to, columns - 1)) if part == 0 else (0, column_to - columns)
                begin, end = cell_starts[row * columns + first], cell_starts[row * columns + last + 1]
                for i in range(begin, end):
                    qx, qy, qz, q_range = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
                    dot = px * qx + py * qy + pz * qz
                    if dot <= 0.0:
                        continue
                    sq_offset = sq_p - dot * dot / (q_range * q_range)
                    if sq_offset > sq_limit:
                        continue
                    name = order[i]
                    observed[name] = True
                    gap = q_range - p_range - tolerance
                    if gap <= 0.0 or gap <= np.sqrt(max(sq_offset, 0.0)) * min(lines[i, 7], max_tangent):
                        continue
                    dx, dy, dz = px - qx, py - qy, pz - qz
                    if abs(lines[i, 4] * dx + lines[i, 5] * dy + lines[i, 6] * dz) <= tolerance:
                        continue
                    if abs(turned[m, 0] * dx + turned[m, 1] * dy + turned[m, 2] * dz) <= tolerance:
                        continue
                    if blocker[name] < 0:
                        num_blocked += 1
                    if blocker[name] < 0 or p_range < blocker_range[name]:
                        blocker[name], blocker_range[name] = m, p_range
        if num_blocked > max_blocked:
            break
    return num_blocked


@_jit
def find_free_blocked(placed, turned, origin, limits, rays, order, cell_starts, rows, columns, met):  # type: ignore[no-untyped-def]
    """met (F,): whether a free ray, by its name, meets a placed point that the sensor would have seen.

    placed, turned, origin: as in find_blockers; limits: (beam radius, sine of its largest half angle,
    smallest range, range of a surface met head on, largest tangent of the incidence angle);
    rays (F, 8): unit directions as fill_lines leaves them, sorted by direction cell; order (F,): their names.
    """
    radius, max_sine, min_range, reach, max_tangent = limits[0], limits[1], limits[2], limits[3], limits[4]
    min_cosine = 1.0 / np.sqrt(1.0 + max_tangent * max_tangent)
    for m in range(placed.shape[0]):
        px, py, pz = placed[m, 0] - origin[0], placed[m, 1] - origin[1], placed[m, 2] - origin[2]
        sq_p = px * px + py * py + pz * pz
        p_range = np.sqrt(sq_p)
        if p_range <= radius or not min_range <= p_range <= reach:
            continue
        cosine = abs(turned[m, 0] * px + turned[m, 1] * py + turned[m, 2] * pz) / p_range
        if cosine < min_cosine or sq_p > cosine * reach * reach:
            continue
        sq_limit = min(radius, p_range * max_sine) ** 2
        row_from, row_to, column_from, column_to = cells_around(px, py, pz, np.sqrt(sq_limit) / p_range, rows, columns)
        for row in range(row_from, row_to + 1):
            for part in range(2 if column_to >= columns else 1):
                first, last = (column_from, min(column_to, columns - 1)) if part == 0 else (0, column_to - columns)
                begin, end = cell_starts[row * columns + first], cell_starts[row * columns + last + 1]
                for i in range(begin, end):
                    dot = px * rays[i, 0] + py * rays[i, 1] + pz * rays[i, 2]
                    if dot > 0.0 and sq_p - dot * dot <= sq_limit:
                        met[order[i]] = True
