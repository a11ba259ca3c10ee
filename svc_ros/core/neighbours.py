"""Search structures of one prepared scan, built once and reused for every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import sight_kernels
from svc_ros.core.scan import Array, IndexArray, PreparedScan

_DIRECTION_CELL_DEG = 1.0
_MIN_RANGE_M = 1e-9


@dataclass(frozen=True, eq=False)
class RadiusGrid:
    """Hashed cells over points (N, 3) [m]: nearest neighbour within a fixed radius."""

    points: Array
    order: IndexArray
    table_keys: IndexArray
    table_start: IndexArray
    table_end: IndexArray
    radius_m: float

    @classmethod
    def build(cls, points: Array, radius_m: float) -> RadiusGrid:
        """Index `points` for queries within `radius_m`."""
        keys = np.empty(len(points), np.int64)
        sight_kernels.fill_keys(points, 1.0 / radius_m, keys)
        order = np.argsort(keys, kind="stable")
        capacity = 1 << max(4, int(2 * max(len(points), 1) - 1).bit_length())
        table_keys, table_start, table_end = (np.empty(capacity, np.int64) for _ in range(3))
        sight_kernels.fill_hash(keys[order], table_keys, table_start, table_end)
        return cls(np.ascontiguousarray(points[order]), order, table_keys, table_start, table_end, radius_m)

    def nearest(self, queries: Array) -> IndexArray:
        """Index (M,) of the nearest point within the radius of each query (M, 3), -1 where there is none."""
        result = np.empty(len(queries), np.int64)
        tables = (self.table_keys, self.table_start, self.table_end)
        sight_kernels.nearest_within(
            np.ascontiguousarray(queries), self.points, self.order, *tables, self.radius_m, self.radius_m, result
        )
        return result


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Sight lines of an observer, sorted into elevation-azimuth cells.

    points, normals: (L, 3), relative to the sensor, in cell order; order: their original indices;
    cell_starts: (rows * columns + 1,).
    """

    points: Array
    normals: Array
    order: IndexArray
    cell_starts: IndexArray
    rows: int
    columns: int

    @classmethod
    def build(cls, relative_points: Array, normals: Array) -> DirectionGrid:
        """Sort points (N, 3) [m], given relative to the sensor, by direction. One at the sensor itself has none."""
        rows, columns = round(180 / _DIRECTION_CELL_DEG), round(360 / _DIRECTION_CELL_DEG)
        lines = np.flatnonzero(np.square(relative_points).sum(1) > _MIN_RANGE_M**2)
        cells = np.empty(len(lines), np.int64)
        sight_kernels.fill_direction_cells(relative_points[lines], rows, columns, cells)
        order = lines[np.argsort(cells, kind="stable")]
        starts = np.concatenate(([0], np.cumsum(np.bincount(cells, minlength=rows * columns))))
        points, normals = (np.ascontiguousarray(a[order]) for a in (relative_points, normals))
        return cls(points, normals, order, starts, rows, columns)


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
