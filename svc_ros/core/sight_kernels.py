"""Hot loops of the sight-line check, compiled by numba; no GIL, no state. Twins in test/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True, error_model="numpy")

_AT_ONCE = 256
_ROUNDING = 1e-6  # of a cell: so near to its border a direction is looked for on both sides


@_jit
def quarter_turns(x, y):  # type: ignore[no-untyped-def]
    """Grows with the azimuth of (x, y), one in each quarter from 0 to 4; no angle is computed."""
    size = abs(x) + abs(y)
    along = y / size if size > 0.0 else 0.0
    ahead = along if along >= 0.0 else 4.0 + along
    return 2.0 - along if x < 0.0 else ahead


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
def fill_relative(points, origin, begin, x, y, z):  # type: ignore[no-untyped-def]
    """x, y, z (K,): points begin.. of (M, 3), seen from the origin; returns how many."""
    num = min(x.shape[0], points.shape[0] - begin)
    for k in range(num):
        x[k], y[k] = points[begin + k, 0] - origin[0], points[begin + k, 1] - origin[1]
        z[k] = points[begin + k, 2] - origin[2]
    return num


@_jit
def fill_bounds(x, y, z, radius, max_sine, rows, columns, bounds):  # type: ignore[no-untyped-def]
    """bounds (4, K): first and last row, first and last column of the cells with all directions around (x, y, z) (K,).

    That is around by the angle whose sine is the smaller one of max_sine and radius over distance; none for points
    within the radius. Columns go round: the first may be below zero, the last beyond their number. rows, columns:
    float64. No branches, no angles: the compiler takes several points at once.
    """
    for k in range(x.shape[0]):
        sq_flat = x[k] * x[k] + y[k] * y[k]
        flat, length = np.sqrt(sq_flat), np.sqrt(sq_flat + z[k] * z[k])
        sine = min(min(radius, length * max_sine) / length, 1.0)
        up, level, cosine = z[k] / length, flat / length, np.sqrt(1.0 - sine * sine)
        low, high = up * cosine - level * sine, up * cosine + level * sine  # sines of the lowest and highest elevation
        pole = level <= sine  # one of them, and so all azimuths, are among the directions
        aside = min(sine / level, 1.0)  # sine of the largest difference of azimuth
        ahead = np.sqrt(1.0 - aside * aside)
        first = quarter_turns(x[k] * ahead + y[k] * aside, y[k] * ahead - x[k] * aside)
        last = quarter_turns(x[k] * ahead - y[k] * aside, y[k] * ahead + x[k] * aside)
        first, last = np.floor(0.25 * first * columns - _ROUNDING), np.floor(0.25 * last * columns + _ROUNDING)
        last = last + columns if last < first else last
        low = -1.0 if (pole and z[k] <= 0.0) else low
        high = 1.0 if (pole and z[k] > 0.0) else high
        bounds[0, k] = max(np.floor((0.5 * low + 0.5) * rows - _ROUNDING), 0.0)
        bounds[1, k] = min(np.floor((0.5 * high + 0.5) * rows + _ROUNDING), rows - 1.0)
        bounds[2, k] = 0.0 if pole else first
        bounds[3, k] = columns - 1.0 if pole else min(last, first + columns - 1.0)


@_jit
def cell_range(row, bounds, k, columns, cell_starts, part):  # type: ignore[no-untyped-def]
    """First entry, and the one after the last, of point k's cells in a row: part 0 up to the seam, part 1 beyond it."""
    first, last = int(bounds[2, k]), int(bounds[3, k])
    if first < 0:
        first, last = first + columns, last + columns
    if part == 1:
        first, last = 0, last - columns  # none where the last is not beyond the seam
    return cell_starts[row * columns + first], cell_starts[row * columns + min(last, columns - 1) + 1]


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
    x, y, z, bounds = np.empty(_AT_ONCE), np.empty(_AT_ONCE), np.empty(_AT_ONCE), np.empty((4, _AT_ONCE))
    num_blocked = 0
    for m in range(placed.shape[0]):
        k = m % _AT_ONCE
        if k == 0:
            num = fill_relative(placed, origin, m, x, y, z)
            fill_bounds(x[:num], y[:num], z[:num], radius, max_sine, float(rows), float(columns), bounds)
        px, py, pz = x[k], y[k], z[k]
        sq_p = px * px + py * py + pz * pz
        p_range = np.sqrt(sq_p)
        if p_range <= radius:
            continue
        sq_limit = min(radius, p_range * max_sine) ** 2
        for row in range(int(bounds[0, k]), int(bounds[1, k]) + 1):
            for part in range(2 if bounds[3, k] >= columns or bounds[2, k] < 0.0 else 1):
                begin, end = cell_range(row, bounds, k, columns, cell_starts, part)
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
    x, y, z, bounds = np.empty(_AT_ONCE), np.empty(_AT_ONCE), np.empty(_AT_ONCE), np.empty((4, _AT_ONCE))
    for m in range(placed.shape[0]):
        k = m % _AT_ONCE
        if k == 0:
            num = fill_relative(placed, origin, m, x, y, z)
            fill_bounds(x[:num], y[:num], z[:num], radius, max_sine, float(rows), float(columns), bounds)
        px, py, pz = x[k], y[k], z[k]
        sq_p = px * px + py * py + pz * pz
        p_range = np.sqrt(sq_p)
        if p_range <= radius or not min_range <= p_range <= reach:
            continue
        cosine = abs(turned[m, 0] * px + turned[m, 1] * py + turned[m, 2] * pz) / p_range
        if cosine < min_cosine or sq_p > cosine * reach * reach:
            continue
        sq_limit = min(radius, p_range * max_sine) ** 2
        for row in range(int(bounds[0, k]), int(bounds[1, k]) + 1):
            for part in range(2 if bounds[3, k] >= columns or bounds[2, k] < 0.0 else 1):
                begin, end = cell_range(row, bounds, k, columns, cell_starts, part)
                for i in range(begin, end):
                    dot = px * rays[i, 0] + py * rays[i, 1] + pz * rays[i, 2]
                    if dot > 0.0 and sq_p - dot * dot <= sq_limit:
                        met[order[i]] = True
