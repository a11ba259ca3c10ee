"""Hot loops of the sight-line check, compiled by numba; no GIL, no state. Twins in test/support/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.direction import cell_range, fill_bounds
from svc_ros.core.kernels.placement import AT_ONCE, turned_dot

_jit = kernel()
# For all the compiler knows, arrays that come out of a call may overlap; written out in the caller they do not.
_into_caller = njit(nogil=True, error_model="numpy", inline="always")

_ZERO = np.int64(0)  # a plain 0 is a type of its own: what it is passed to, compiled twice
_HITS = 1024  # lines that pass a point closely are judged so many at a time


@_jit
def place_alone(T, points, nearest, origin, begin, names, x, y, z):  # type: ignore[no-untyped-def]
    """The next points (M, 3), from `begin` on, that lie on nothing: how many, and where those after them begin.

    names (K + 1,): their indices; x, y, z (K,): where the pose T (4, 4) puts them, seen from the origin.
    """
    num, end = 0, begin
    while end < nearest.shape[0] and num < x.shape[0]:
        start, end = end, min(end + x.shape[0] - num, nearest.shape[0])
        for m in range(start, end):
            names[num] = m
            num += nearest[m] < 0
    for k in range(num):
        a, b, c = points[names[k], 0], points[names[k], 1], points[names[k], 2]
        x[k] = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3] - origin[0]
        y[k] = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3] - origin[1]
        z[k] = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - origin[2]
    return num, end


@_into_caller
def make_batch():  # type: ignore[no-untyped-def]
    """Room for the points that are looked at together, as place_batch fills it: names, x, y, z, bounds, sizes."""
    x, y, z, names = np.empty(AT_ONCE), np.empty(AT_ONCE), np.empty(AT_ONCE), np.empty(AT_ONCE + 1, np.int64)
    return names, x, y, z, np.empty((4, AT_ONCE), np.int32), np.empty((3, AT_ONCE))


@_into_caller
def place_batch(T, points, nearest, origin, begin, reach, grid, batch):  # type: ignore[no-untyped-def]
    """The next points, as place_alone has them, with the cells of the grid around each: how many, and where to go on.

    reach: beam radius and sine of the largest half angle; bounds, sizes: see fill_bounds.
    """
    _, _, _, _, rows, columns = grid
    names, x, y, z, bounds, sizes = batch
    num, end = place_alone(T, points, nearest, origin, begin, names, x, y, z)
    fill_bounds(x[:num], y[:num], z[:num], reach[0], reach[1], float(rows), float(columns), bounds, sizes)
    return num, end


@_jit
def judge_hits(num_hits, hits, batch, T, normals, limits, grid, found):  # type: ignore[no-untyped-def]
    """Note which lines are observed and which are blocked, of those that pass a point closely.

    hits: points of the batch and places of lines in the grid; the rest as in find_blockers.
    """
    of_point, of_line = hits
    names, x, y, z, _, sizes = batch
    tolerance, max_tangent = limits[0], limits[3]
    lines, surfaces, order = grid[0], grid[1], grid[2]
    blocker, blocker_range, observed = found
    for h in range(num_hits):
        k, i = of_point[h], of_line[h]
        observed[i] = True
        q_range, p_range = lines[i, 3], sizes[1, k]
        gap = q_range - p_range - tolerance
        if gap <= 0.0:
            continue
        dot = x[k] * lines[i, 0] + y[k] * lines[i, 1] + z[k] * lines[i, 2]
        sq_offset = sizes[0, k] - dot * dot / (q_range * q_range)
        if gap <= np.sqrt(max(sq_offset, 0.0)) * min(surfaces[i, 3], max_tangent):
            continue
        dx, dy, dz = x[k] - lines[i, 0], y[k] - lines[i, 1], z[k] - lines[i, 2]
        if abs(surfaces[i, 0] * dx + surfaces[i, 1] * dy + surfaces[i, 2] * dz) <= tolerance:
            continue
        if abs(turned_dot(T, normals[names[k]], dx, dy, dz)) <= tolerance:
            continue
        name = order[i]
        if blocker[name] < 0 or p_range < blocker_range[name]:
            blocker[name], blocker_range[name] = names[k], p_range


@_jit
def find_blockers(T, points, normals, nearest, origin, limits, grid, found):  # type: ignore[no-untyped-def]
    """Find the sight lines that end behind a point of the other scan.

    T (4, 4): the other scan's pose in the observer's frame; points, normals (M, 3): its own; nearest (M,): below zero
    where a point lies on nothing of the observer's surface: only such points block; origin (3,): the sensor;
    limits: (tolerance, beam radius, sine of the largest half angle, largest tangent of the incidence angle); grid: the
    tables of a DirectionGrid (lines (L, 4) ...); found: blocker (N,), by the line's name, the nearest point that blocks
    it, or -1; blocker_range (N,), its range; observed (L,), by its place in the grid, whether any point that may block
    lies along the line.
    A point p blocks the line to q if the line passes within the beam radius of it, its range is smaller than q's by
    more than the tolerance plus what the surface at q may rise within that radius, and neither surface's tangent
    plane contains the other point within the tolerance.
    """
    lines, _, _, cell_starts, rows, columns = grid
    radius, reach = limits[1], (limits[1], limits[2])
    batch = make_batch()
    _, x, y, z, bounds, sizes = batch
    of_point, of_line = np.empty(_HITS + 1, np.uint32), np.empty(_HITS + 1, np.uint32)
    hits = (of_point, of_line)
    next_point = _ZERO
    while next_point < nearest.shape[0]:
        num, next_point = place_batch(T, points, nearest, origin, next_point, reach, grid, batch)
        num_hits = _ZERO
        for k in range(num):
            px, py, pz, sq_p, sq_limit = x[k], y[k], z[k], sizes[0, k], sizes[2, k]
            if sizes[1, k] <= radius:
                continue
            for column in range(bounds[2, k], bounds[3, k] + 1):
                begin, end = cell_range(column, bounds, k, rows, columns, cell_starts)
                for i in range(np.uint64(begin), np.uint64(end)):  # no branch on what is found: it cannot be foretold
                    q_range = lines[i, 3]
                    dot = px * lines[i, 0] + py * lines[i, 1] + pz * lines[i, 2]
                    of_point[num_hits], of_line[num_hits] = k, i
                    num_hits += (dot > 0.0) & (sq_p - dot * dot / (q_range * q_range) <= sq_limit)
                    if num_hits == _HITS:
                        judge_hits(num_hits, hits, batch, T, normals, limits, grid, found)
                        num_hits = _ZERO
        judge_hits(num_hits, hits, batch, T, normals, limits, grid, found)


@_jit
def find_free_blocked(T, points, normals, nearest, origin, limits, grid, met):  # type: ignore[no-untyped-def]
    """met (F,): whether a free ray of the grid meets a placed point that the sensor would have seen.

    T, points, normals, nearest, origin, grid: as in find_blockers; limits: (beam radius, sine of its largest half
    angle, smallest range, range of a surface met head on, largest tangent of the incidence angle).
    """
    rays, _, _, cell_starts, rows, columns = grid
    radius, reach = limits[0], (limits[0], limits[1])
    min_range, max_range, max_tangent = limits[2], limits[3], limits[4]
    min_cosine = 1.0 / np.sqrt(1.0 + max_tangent * max_tangent)
    batch = make_batch()
    names, x, y, z, bounds, sizes = batch
    next_point = _ZERO
    while next_point < nearest.shape[0]:
        num, next_point = place_batch(T, points, nearest, origin, next_point, reach, grid, batch)
        for k in range(num):
            px, py, pz, sq_p, p_range, sq_limit = x[k], y[k], z[k], sizes[0, k], sizes[1, k], sizes[2, k]
            if p_range <= radius or not min_range <= p_range <= max_range:
                continue
            cosine = abs(turned_dot(T, normals[names[k]], px, py, pz)) / p_range
            if cosine < min_cosine or sq_p > cosine * max_range * max_range:
                continue
            for column in range(bounds[2, k], bounds[3, k] + 1):
                begin, end = cell_range(column, bounds, k, rows, columns, cell_starts)
                for i in range(begin, end):
                    dot = px * rays[i, 0] + py * rays[i, 1] + pz * rays[i, 2]
                    if dot > 0.0 and sq_p - dot * dot <= sq_limit:
                        met[i] = True
