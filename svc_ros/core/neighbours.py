"""Search structures of one prepared scan, built once and reused for every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import neighbour_kernels, sight_kernels
from svc_ros.core.scan import Array, IndexArray, PreparedScan

_DIRECTION_CELL_DEG = 1.0
_MIN_RANGE_M = 1e-9
_MAX_CELLS_ALONG = 1000  # a scan that is larger gets larger cells


@dataclass(frozen=True, eq=False)
class RadiusGrid:
    """Cells in columns along z over points (N, 3) [m]: nearest neighbour within a fixed radius.

    shape: corner (3,), edge and columns along x and y; points: by cell; order: (N,) their original indices;
    column_low, column_first, starts: where the cells of a column and the points of a cell begin.
    """

    shape: Array
    points: Array
    order: IndexArray
    column_low: IndexArray
    column_first: IndexArray
    starts: IndexArray
    radius_m: float

    @classmethod
    def build(cls, points: Array, radius_m: float) -> RadiusGrid:
        """Index `points` for queries within `radius_m`."""
        corner, extent = np.zeros(3), np.zeros(3)
        if len(points):
            corner = points.min(0)
            extent = points.max(0) - corner
        edge = max(radius_m * (1.0 + 1e-9), float(extent.max()) / _MAX_CELLS_ALONG)
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
        return cls(shape, np.ascontiguousarray(points[order]), order, low, first, starts, radius_m)

    @property
    def tables(self) -> tuple[Array, Array, IndexArray, IndexArray, IndexArray, IndexArray]:
        """The grid as kernels take it."""
        return self.shape, self.points, self.order, self.column_low, self.column_first, self.starts

    def nearest(self, queries: Array) -> IndexArray:
        """Index (M,) of the nearest point within the radius of each query (M, 3), -1 where there is none."""
        result = np.empty(len(queries), np.int64)
        neighbour_kernels.find_nearest(np.ascontiguousarray(queries), self.radius_m, *self.tables, result)
        return result


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Sight lines of an observer, sorted into elevation-azimuth cells.

    lines: (L, 8) in cell order, relative to the sensor: end point, range [m], normal, tangent of the incidence angle;
    order: their original indices; cell_starts: (rows * columns + 1,).
    """

    lines: Array
    order: IndexArray
    cell_starts: IndexArray
    rows: int
    columns: int

    @classmethod
    def build(cls, relative_points: Array, normals: Array) -> DirectionGrid:
        """Sort points (N, 3) [m], given relative to the sensor, by direction. One at the sensor itself has none."""
        rows, columns = round(180 / _DIRECTION_CELL_DEG), round(360 / _DIRECTION_CELL_DEG)
        seen = np.flatnonzero(np.square(relative_points).sum(1) > _MIN_RANGE_M**2)
        cells = np.empty(len(seen), np.int64)
        sight_kernels.fill_direction_cells(relative_points[seen], rows, columns, cells)
        order = seen[np.argsort(cells, kind="stable")]
        starts = np.concatenate(([0], np.cumsum(np.bincount(cells, minlength=rows * columns))))
        lines = np.empty((len(order), 8))
        sight_kernels.fill_lines(np.ascontiguousarray(relative_points), normals, order, lines)
        return cls(lines, order, starts, rows, columns)


def radius_grid(scan: PreparedScan, radius_m: float) -> RadiusGrid:
    """The scan's own RadiusGrid of that radius, built on first use."""
    key = ("radius_grid", radius_m)
    if key not in scan.memo:
        scan.memo[key] = RadiusGrid.build(scan.points, radius_m)
    grid: RadiusGrid = scan.memo[key]
    return grid


def direction_grid(scan: PreparedScan) -> DirectionGrid:
    """The scan's own sight lines by direction, built on first use."""
    if "direction_grid" not in scan.memo:
        scan.memo["direction_grid"] = DirectionGrid.build(scan.points - scan.sensor_origin, scan.normals)
    grid: DirectionGrid = scan.memo["direction_grid"]
    return grid
