"""Search structures of one prepared scan, built once and reused for every pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.kernels import direction as direction_kernels
from svc_ros.core.kernels import nearest as nearest_kernels
from svc_ros.core.kernels import neighbour as neighbour_kernels
from svc_ros.core.scan import Array, IndexArray, PreparedScan

_CELL_HEIGHT_DEG, _CELL_WIDTH_DEG = 0.2, 1.5  # at the horizon
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

    shape: corner (3,), edge of a column, columns along x and y, height of a cell; spans, starts: where the cells of
    a column and the entries of a cell begin; blocks: (B, 3, LANES) [m] from the corner; names: (B, LANES).
    """

    shape: Array
    spans: IntArray
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
        spans = np.empty((num_columns + 1, 2), np.int32)
        num_cells = nearest_kernels.fill_levels(points, shape, columns, levels, spans)
        num_blocks = -(-9 * len(points) // lanes)
        starts, names = np.empty(num_cells + 1, np.int32), np.empty((num_blocks, lanes), np.int32)
        blocks = np.empty((num_blocks, 3, lanes), np.float32)
        blocks[-1:] = _NOWHERE_M
        nearest_kernels.fill_blocks(points, shape, columns, levels, spans, starts, blocks, names)
        return cls(shape, spans, starts, blocks, names, radius_m)

    @property
    def tables(self) -> tuple[Array, IntArray, IntArray, NDArray[np.float32], IntArray]:
        """The grid as kernels take it."""
        return self.shape, self.spans, self.starts, self.blocks, self.names

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
    """Sight lines of an observer, sorted into cells of azimuth and elevation.

    lines: (L, 4) in cell order, relative to the sensor: end point and range [m]; surfaces: (L, 4) normal and tangent
    of the incidence angle; order: (L,) original indices; cell_starts: (columns * rows + 1,).
    """

    lines: Array
    surfaces: Array
    order: IndexArray
    cell_starts: IntArray
    rows: int
    columns: int

    @classmethod
    def build(cls, relative_points: Array, normals: Array) -> DirectionGrid:
        """Sort points (N, 3) [m], given relative to the sensor, by direction. One at the sensor itself has none."""
        rows, columns = round(2.0 / math.radians(_CELL_HEIGHT_DEG)), round(360.0 / _CELL_WIDTH_DEG)
        seen = np.flatnonzero(np.square(relative_points).sum(1) > _MIN_RANGE_M**2)
        cells = np.empty(len(seen), np.int64)
        direction_kernels.fill_direction_cells(relative_points[seen], rows, columns, cells)
        order = seen[np.argsort(cells, kind="stable")]
        starts = np.concatenate(([0], np.cumsum(np.bincount(cells, minlength=rows * columns)))).astype(np.int32)
        lines, surfaces = np.empty((len(order), 4)), np.empty((len(order), 4))
        direction_kernels.fill_lines(np.ascontiguousarray(relative_points), normals, order, lines, surfaces)
        return cls(lines, surfaces, order, starts, rows, columns)

    @property
    def tables(self) -> tuple[Array, Array, IndexArray, IntArray, int, int]:
        """The grid as kernels take it."""
        return self.lines, self.surfaces, self.order, self.cell_starts, self.rows, self.columns


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
