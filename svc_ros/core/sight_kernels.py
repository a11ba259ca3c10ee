"""Hot loops of the sight-line check, compiled by numba; no GIL, no state. Twins in test/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

_jit = njit(nogil=True, cache=True)

_HASH_FACTOR = np.int64(-7046029254386353131)  # 2^64 / golden ratio, as a signed word
_AXIS_BITS = 21
_AXIS_OFFSET = 1 << 20


@_jit
def cell_key(x, y, z, inverse_edge):  # type: ignore[no-untyped-def]
    """Packed integer coordinates of the cell that holds a point (21 bits an axis)."""
    i = np.int64(np.floor(x * inverse_edge)) + _AXIS_OFFSET
    j = np.int64(np.floor(y * inverse_edge)) + _AXIS_OFFSET
    k = np.int64(np.floor(z * inverse_edge)) + _AXIS_OFFSET
    return (i << (2 * _AXIS_BITS)) + (j << _AXIS_BITS) + k  # a sum: neighbours stay neighbours beyond 21 bits


@_jit
def fill_keys(points, inverse_edge, keys):  # type: ignore[no-untyped-def]
    """keys (N,): packed cell of every point."""
    for i in range(points.shape[0]):
        keys[i] = cell_key(points[i, 0], points[i, 1], points[i, 2], inverse_edge)


@_jit
def fill_hash(sorted_keys, table_keys, table_start, table_end):  # type: ignore[no-untyped-def]
    """Open-addressing table from a cell's key to its run in the sorted points; empty slots hold start = -1."""
    mask = table_keys.shape[0] - 1
    table_start[:] = -1
    i = 0
    n = sorted_keys.shape[0]
    while i < n:
        key = sorted_keys[i]
        end = i + 1
        while end < n and sorted_keys[end] == key:
            end += 1
        slot = ((key * _HASH_FACTOR) >> 32) & mask
        while table_start[slot] >= 0:
            slot = (slot + 1) & mask
        table_keys[slot], table_start[slot], table_end[slot] = key, i, end
        i = end


@_jit
def nearest_within(queries, points, order, table_keys, table_start, table_end, edge, radius, nearest):  # type: ignore[no-untyped-def]
    """nearest (M,): index of the nearest point within `radius` of each query, ties to the smaller index, -1 if none.

    points: sorted by cell; order: their original indices; radius must not exceed the cell's edge.
    """
    mask = table_keys.shape[0] - 1
    inverse_edge = 1.0 / edge
    for m in range(queries.shape[0]):
        x, y, z = queries[m, 0], queries[m, 1], queries[m, 2]
        best, found = radius * radius, -1
        base = cell_key(x, y, z, inverse_edge)
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    key = base + (a << (2 * _AXIS_BITS)) + (b << _AXIS_BITS) + c
                    slot = ((key * _HASH_FACTOR) >> 32) & mask
                    while table_start[slot] >= 0 and table_keys[slot] != key:
                        slot = (slot + 1) & mask
                    if table_start[slot] < 0:
                        continue
                    for i in range(table_start[slot], table_end[slot]):
                        dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
                        sq = dx * dx + dy * dy + dz * dz
                        if sq < best or (sq == best and found >= 0 and order[i] < found):
                            best, found = sq, order[i]
        nearest[m] = found


@_jit
def fill_direction_cells(points, rows, columns, cells):  # type: ignore[no-untyped-def]
    """cells (N,): row-major elevation-azimuth cell of each point's direction from the origin."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        flat = np.sqrt(x * x + y * y)
        row = int((np.arctan2(z, flat) / np.pi + 0.5) * rows)
        column = int((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * columns)
        cells[i] = min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)


@_jit
def find_blockers(p, p_normals, p_idx, q, q_normals, q_order, cell_starts, rows, columns, limits, blocker, blocker_range, observed):  # type: ignore[no-untyped-def]  # fmt: skip  # noqa: E501
    """Which sight lines end behind a point of the other scan.

    p (M, 3): the other scan's points that lie on nothing, relative to the observer; p_idx (M,): their names;
    q (N, 3): the observer's points sorted by direction cell; q_order (N,): their names;
    limits: (tolerance, beam radius, largest half angle, largest tangent of the incidence angle);
    blocker (N,): in q's naming, the nearest point that blocks the line, or -1; blocker_range (N,): its range;
    observed (N,): whether any of p lies along the line.
    A point p blocks the line to q if the line passes within the beam radius of it, its range is smaller than q's by
    more than the tolerance plus what the surface at q may rise within that radius, and neither surface's tangent
    plane contains the other point within the tolerance.
    """
    tolerance, radius, max_angle, max_tangent = limits[0], limits[1], limits[2], limits[3]
    for m in range(p.shape[0]):
        px, py, pz = p[m, 0], p[m, 1], p[m, 2]
        flat = np.sqrt(px * px + py * py)
        p_range = np.sqrt(flat * flat + pz * pz)
        if p_range <= radius:
            continue
        angle = min(np.arcsin(radius / p_range), max_angle)
        limit = p_range * np.sin(angle)
        elevation = np.arctan2(pz, flat)
        azimuth = np.arctan2(py, px)
        row_from = max(int(((elevation - angle) / np.pi + 0.5) * rows), 0)
        row_to = min(int(((elevation + angle) / np.pi + 0.5) * rows), rows - 1)
        cosine = np.cos(min(abs(elevation) + angle, 0.5 * np.pi))
        spread = np.pi
        if cosine * np.pi > np.sin(angle):
            spread = np.arcsin(min(1.0, np.sin(angle) / max(cosine, 1e-9)))
        column_from = int(np.floor(((azimuth - spread) / (2.0 * np.pi) + 0.5) * columns))
        column_to = int(np.floor(((azimuth + spread) / (2.0 * np.pi) + 0.5) * columns))
        if column_to - column_from >= columns:
            column_to = column_from + columns - 1
        for row in range(row_from, row_to + 1):
            for column in range(column_from, column_to + 1):
                cell = row * columns + column % columns
                for i in range(cell_starts[cell], cell_starts[cell + 1]):
                    qx, qy, qz = q[i, 0], q[i, 1], q[i, 2]
                    q_range = np.sqrt(qx * qx + qy * qy + qz * qz)
                    along = (px * qx + py * qy + pz * qz) / q_range
                    sq_offset = p_range * p_range - along * along
                    if along <= 0.0 or sq_offset > limit * limit:
                        continue
                    name = q_order[i]
                    observed[name] = True
                    gap = q_range - p_range
                    if gap <= tolerance:
                        continue
                    dx, dy, dz = px - qx, py - qy, pz - qz
                    nq = q_normals[i]
                    incidence = abs(qx * nq[0] + qy * nq[1] + qz * nq[2]) / q_range
                    tangent = min(np.sqrt(max(1.0 - incidence * incidence, 0.0)) / max(incidence, 1e-9), max_tangent)
                    if gap <= tolerance + np.sqrt(max(sq_offset, 0.0)) * tangent:
                        continue
                    if abs(nq[0] * dx + nq[1] * dy + nq[2] * dz) <= tolerance:
                        continue
                    if abs(p_normals[m, 0] * dx + p_normals[m, 1] * dy + p_normals[m, 2] * dz) <= tolerance:
                        continue
                    if blocker[name] < 0 or p_range < blocker_range[name]:
                        blocker[name], blocker_range[name] = p_idx[m], p_range


@_jit
def count_agreeing(T, points, normals, table_keys, table_start, cell_normals, edge, min_cosine, agreeing):  # type: ignore[no-untyped-def]
    """agreeing (H,): points that each pose puts into an occupied cell whose normal agrees with the point's own."""
    mask = table_keys.shape[0] - 1
    inverse_edge = 1.0 / edge
    for h in range(T.shape[0]):
        R, count = T[h], 0
        for i in range(points.shape[0]):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            key = cell_key(
                R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + R[0, 3],
                R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + R[1, 3],
                R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + R[2, 3],
                inverse_edge,
            )
            slot = ((key * _HASH_FACTOR) >> 32) & mask
            while table_start[slot] >= 0 and table_keys[slot] != key:
                slot = (slot + 1) & mask
            if table_start[slot] < 0:
                continue
            cosine = 0.0
            for a in range(3):
                turned = R[a, 0] * normals[i, 0] + R[a, 1] * normals[i, 1] + R[a, 2] * normals[i, 2]
                cosine += turned * cell_normals[table_start[slot], a]
            if cosine > min_cosine:
                count += 1
        agreeing[h] = count
