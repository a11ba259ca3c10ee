"""Directions by cell, and the cells around a direction, compiled by numba; no GIL, no state.

Cells are columns of azimuth and, in each, rows by the sine of the elevation. Twins in test/.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()

_ROUNDING = 1e-6  # of a cell: so near to its border a direction is looked for on both sides
_ARC_SINE = 0.5708  # arcsin(a) <= a + this * a^3
_TINY = 1e-300


@_jit
def quarter_turns(x, y):  # type: ignore[no-untyped-def]
    """Grows with the azimuth of (x, y), one in each quarter from 0 to 4; no angle is computed."""
    along = y / max(abs(x) + abs(y), _TINY)
    ahead = along if along >= 0.0 else 4.0 + along
    return 2.0 - along if x < 0.0 else ahead


@_jit
def fill_direction_cells(points, rows, columns, cells):  # type: ignore[no-untyped-def]
    """cells (N,): cell of each point's direction from the origin: by its azimuth, then by the sine of its elevation."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        row = int((0.5 * z / np.sqrt(x * x + y * y + z * z) + 0.5) * rows)
        column = int(0.25 * quarter_turns(x, y) * columns)
        cells[i] = min(max(column, 0), columns - 1) * rows + min(max(row, 0), rows - 1)


@_jit
def fill_lines(points, normals, order, lines, surfaces):  # type: ignore[no-untyped-def]
    """lines (L, 4): end point and range of each sight line; surfaces (L, 4): normal and tangent of its incidence."""
    for i in range(order.shape[0]):
        x, y, z = points[order[i], 0], points[order[i], 1], points[order[i], 2]
        a, b, c = normals[order[i], 0], normals[order[i], 1], normals[order[i], 2]
        length = np.sqrt(x * x + y * y + z * z)
        cosine = abs(x * a + y * b + z * c) / length
        lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3] = x, y, z, length
        surfaces[i, 0], surfaces[i, 1], surfaces[i, 2] = a, b, c
        surfaces[i, 3] = np.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-9)


@_jit
def fill_bounds(x, y, z, radius, max_sine, rows, columns, bounds, sizes):  # type: ignore[no-untyped-def]
    """bounds (4, K): first and last row, first and last column of cells that hold all directions around (x, y, z) (K,).

    That is around by the angle whose sine is the smaller one of max_sine and radius over distance; a little more is
    allowed for, so that no angle has to be computed. Columns go round: the first may be below zero, the last beyond
    their number. sizes (3, K): squared distance, distance, and square of the offset at which a line just passes by.
    rows, columns: float64. No branches: the compiler takes several points at once.
    """
    for k in range(x.shape[0]):
        sq_flat = x[k] * x[k] + y[k] * y[k]
        sq = sq_flat + z[k] * z[k]
        flat, length = np.sqrt(sq_flat), np.sqrt(sq)
        offset = min(radius, length * max_sine)
        sizes[0, k], sizes[1, k], sizes[2, k] = sq, length, offset * offset
        inverse = 1.0 / length
        sine, up = offset * inverse, z[k] * inverse
        rise = sine * (flat * inverse + sine)  # of the sine of the elevation: 1 - cosine <= sine^2
        bounds[0, k] = np.int32(max(np.floor((0.5 * (up - rise) + 0.5) * rows - _ROUNDING), 0.0))
        bounds[1, k] = np.int32(min(np.floor((0.5 * (up + rise) + 0.5) * rows + _ROUNDING), rows - 1.0))
        turns, inverse = quarter_turns(x[k], y[k]), 1.0 / max(abs(x[k]) + abs(y[k]), _TINY)
        aside = min(offset / flat, 1.0)  # sine of the largest difference of azimuth
        angle = aside + _ARC_SINE * aside * aside * aside
        steepness = sq_flat * inverse * inverse  # of quarter turns over azimuth, which itself has a slope of 2 at most
        width = min(angle * (steepness + angle), 2.0)
        first = np.floor(0.25 * (turns - width) * columns - _ROUNDING)
        last = np.floor(0.25 * (turns + width) * columns + _ROUNDING)
        bounds[2, k], bounds[3, k] = np.int32(first), np.int32(min(last, first + columns - 1.0))


@_jit
def cell_range(column, bounds, k, rows, columns, cell_starts):  # type: ignore[no-untyped-def]
    """First line, and the one after the last, of point k's cells in a column, which may lie beyond the seam."""
    column = column + columns if column < 0 else (column - columns if column >= columns else column)
    return cell_starts[column * rows + bounds[0, k]], cell_starts[column * rows + bounds[1, k] + 1]
