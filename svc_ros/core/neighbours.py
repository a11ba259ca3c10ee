"""Search structures of one prepared scan, built once and reused for every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import nearest_kernels, neighbour_kernels, sight_kernels
from svc_ros.core.scan import Array, IndexArray, PreparedScan

_DIRECTION_CELL_DEG = 0.7  # high at the horizon, wide on average
_MIN_RANGE_M = 1e-9
_MAX_CELLS_ALONG = 1000  # a scan that is larger gets larger cells
_LOWEST_CELL = 0.01  # of a column's edge: a cell's height at least
_NOWHERE_M = 1e9

IntArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class RadiusGrid:
    """Cells in columns along z over points (N, 3) [m]: all neighbours of a point within a fixed radius.

    shape: corner (3,), edge and columns along x and y; points: by cell; order: (N,) their original indices;
    column_low, column_first, starts: where the cells of a column and the points of a cell begin.
    """

    shape: Array
    points: Array
    order: IndexArray
    column_low: IndexArray
    column_first: IndexArray
    starts: IndexArray

    @classmethod
    def build(cls, points: Array, radius_m: float) -> RadiusGrid:
        """Index `points` for what is within `radius_m` of each of them."""
        corner, edge = _corner_and_edge(points, radius_m)
        i, j, level = np.floor((points - corner) / edge).astype(np.int64).T
        num_x, num_y = (int(a.max(initial=0)) + 1 for a in (i, j))
        column = i * num_y + j
        order = np.lexsort((level, column))
        column, level = column[order], level[order]
        low, first = np.zeros(num_x * num_y, np.int64), np.empty(num_x * num_y + 1, np.int64)
        neighbour_kernels.fill_columns(column, level, low, first)
        starts = np.empty(first[-1] + 1, np.int64)
        neighbour_kernels.fill_cells(column, level, low, first, starts)
        shape = np.array([*corner, edge, num_x, num_y])
        return cls(shape, np.ascontiguousarray(points[order]), order, low, first, starts)


@dataclass(frozen=True, eq=False)
class NearestGrid:
    """Points (N, 3) [m], nine times each, for the nearest one within a fixed radius of any query.

    shape: corner (3,), edge of a column, columns along x and y, height of a cell; low, first, starts: where the cells
    of a column and the entries of a cell begin; blocks: (B, 3, LANES) [m] from the corner; names: (B, LANES).
    """

    shape: Array
    low: IntArray
    first: IntArray
    starts: IntArray
    blocks: NDArray[np.float32]
    names: IntArray
    radius_m: float

    @classmethod
    def build(cls, points: Array, radius_m: float) -> NearestGrid:
        """Index `points` for queries within `radius_m`."""
        corner, edge = _corner_and_edge(points, radius_m)
        num_x, num_y = (int(np.max((points[:, k] - corner[k]) / edge, initial=0.0)) + 1 for k in range(2))
        shape = np.array([*corner, edge, num_x, num_y, max(radius_m, _LOWEST_CELL * edge) / nearest_kernels.LEVELS])
        num_columns, lanes = (num_x + 2) * (num_y + 2), nearest_kernels.LANES
        columns, levels = np.empty(len(points), np.int32), np.empty(len(points), np.int32)
        low, first = np.empty(num_columns, np.int32), np.empty(num_columns + 1, np.int32)
        num_cells = nearest_kernels.fill_levels(points, shape, columns, levels, low, first)
        num_blocks = -(-9 * len(points) // lanes)
        starts, names = np.empty(num_cells + 1, np.int32), np.empty((num_blocks, lanes), np.int32)
        blocks = np.empty((num_blocks, 3, lanes), np.float32)
        blocks[-1:] = _NOWHERE_M
        nearest_kernels.fill_blocks(points, shape, columns, levels, low, first, starts, blocks, names)
        return cls(shape, low, first, starts, blocks, names, radius_m)

    @property
    def tables(self) -> tuple[Array, IntArray, IntArray, IntArray, NDArray[np.float32], IntArray]:
        """The grid as kernels take it."""
        return self.shape, self.low, self.first, self.starts, self.blocks, self.names

    def nearest(self, queries: Array) -> IndexArray:
        """Index (M,) of the nearest point within the radius of each query (M, 3), -1 where there is none."""
        result = np.empty(len(queries), np.int64)
        nearest_kernels.find_nearest(np.ascontiguousarray(queries), self.radius_m, *self.tables, result)
        return result


def _corner_and_edge(points: Array, radius_m: float) -> tuple[Array, float]:
    """Lowest corner (3,) of points (N, 3), and an edge of cells that is no smaller than the radius."""
    if len(points) == 0:
        return np.zeros(3), radius_m
    corner = points.min(0)
    extent = float((points.max(0) - corner).max())
    return corner, max(radius_m * (1.0 + 1e-9), extent / _MAX_CELLS_ALONG)


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Sight lines of an observer, sorted into cells of elevation and azimuth.

    lines: (L, 8) in cell order, relative to the sensor: end point, range [m], normal, tangent of the incidence angle;
    order: their original indices; cell_starts: (rows * columns + 1,).
    """

    lines: Array
    order: IndexArray
    cell_starts: IntArray
    rows: int
    columns: int

    @classmethod
    def build(cls, relative_points: Array, normals: Array) -> DirectionGrid:
        """Sort points (N, 3) [m], given relative to the sensor, by direction. One at the sensor itself has none."""
        rows, columns = round(2.0 / np.radians(_DIRECTION_CELL_DEG)), round(360 / _DIRECTION_CELL_DEG)
        seen = np.flatnonzero(np.square(relative_points).sum(1) > _MIN_RANGE_M**2)
        cells = np.empty(len(seen), np.int64)
        sight_kernels.fill_direction_cells(relative_points[seen], rows, columns, cells)
        order = seen[np.argsort(cells, kind="stable")]
        starts = np.concatenate(([0], np.cumsum(np.bincount(cells, minlength=rows * columns)))).astype(np.int32)
        lines = np.empty((len(order), 8))
        sight_kernels.fill_lines(np.ascontiguousarray(relative_points), normals, order, lines)
        return cls(lines, order, starts, rows, columns)


def nearest_grid(scan: PreparedScan, radius_m: float) -> NearestGrid:
    """The scan's own NearestGrid of that radius, built on first use."""
    key = ("nearest_grid", radius_m)
    if key not in scan.memo:
        scan.memo[key] = NearestGrid.build(scan.points, radius_m)
    grid: NearestGrid = scan.memo[key]
    return grid


def direction_grid(scan: PreparedScan) -> DirectionGrid:
    """The scan's own sight lines by direction, built on first use."""
    if "direction_grid" not in scan.memo:
        scan.memo["direction_grid"] = DirectionGrid.build(scan.points - scan.sensor_origin, scan.normals)
    grid: DirectionGrid = scan.memo["direction_grid"]
    return grid
