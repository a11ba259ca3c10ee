"""A levelled scan from above: upright surface with the way it faces, and the cells that the sensor looked across."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from svc_ros.core.kernels import wall_map as wall_map_kernels
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import apply

_CELLS_M = (0.25, 0.5, 1.0)  # edges of a cell
_SIZES = (96, 128, 160, 192)  # cells along an edge of a map
_ROOM = 0.45  # of the map's edge: how far from the sensor walls are drawn
_UPRIGHT, _LYING = 0.5, 0.8  # z of a normal
_ABOVE_GROUND_M, _EYE_LEVEL_M = 0.4, 4.0  # surface lower or higher stops no sight line of those that are drawn
_RAYS = 3000
_STEP, _SHORT = 0.7, 1.5  # of a ray, and how far before its end it stops, in cells


class Raster(NamedTuple):
    """A square map: the edge of a cell [m], and cells along an edge. Cells are named by their middles, from 0 on."""

    cell_m: float
    size: int

    @property
    def reach_m(self) -> float:
        """Distance [m] from the sensor within which surface is drawn."""
        return _ROOM * self.size * self.cell_m


@dataclass(frozen=True, eq=False)
class WallMap:
    """walls, normals: (N, 2) [m], unit; taken, free: (A, 2), (B, 2) middles of cells [m] with a wall and without.

    All in the level frame of `T_level_scan` (4, 4), the sensor at the origin.
    """

    T_level_scan: Array
    walls: Array
    normals: Array
    taken: Array
    free: Array


def choose_raster(source: PreparedScan, target: PreparedScan) -> Raster:
    """The finest, and of those the smallest, in which both scans have room; the largest where none has."""
    reach = max(_reach_m(source), _reach_m(target))
    cell_m = next((cell_m for cell_m in _CELLS_M if Raster(cell_m, _SIZES[-2]).reach_m >= reach), _CELLS_M[-1])
    size = next((size for size in _SIZES if Raster(cell_m, size).reach_m >= reach), _SIZES[-1])
    return Raster(cell_m, size)


def _reach_m(scan: PreparedScan) -> float:
    """Distance [m] from the sensor within which nearly all points of a scan lie."""
    if "reach" not in scan.memo:
        scan.memo["reach"] = float(np.quantile(np.linalg.norm(scan.points - scan.sensor_origin, axis=1), 0.99))
    reach: float = scan.memo["reach"]
    return reach


def wall_map(scan: PreparedScan, T_level_scan: Array, raster: Raster) -> WallMap:
    """The map of a scan that stands so; drawn once a scan and raster."""
    kept = scan.memo.get(("wall_map", raster))
    if kept is None or kept[0] is not T_level_scan:
        kept = T_level_scan, _draw(scan, T_level_scan, raster)
        scan.memo["wall_map", raster] = kept
    drawn: WallMap = kept[1]
    return drawn


def _draw(scan: PreparedScan, T: Array, raster: Raster) -> WallMap:
    points, normals = apply(T, scan.points), scan.normals @ T[:3, :3].T
    flat, height, cell_m, half = np.linalg.norm(points[:, :2], axis=1), points[:, 2], raster.cell_m, raster.size // 2
    near = flat < raster.reach_m
    upright = near & (np.abs(normals[:, 2]) < _UPRIGHT) & (height > _ABOVE_GROUND_M)
    walls, facing = points[upright, :2], normals[upright, :2]
    taken = np.unique(_cells(walls, cell_m), axis=0)
    free = np.zeros((raster.size, raster.size), bool)
    seen = points[(height > _ABOVE_GROUND_M) & (height < _EYE_LEVEL_M), :2]
    rays = np.ascontiguousarray(seen[:: max(1, len(seen) // _RAYS)])
    wall_map_kernels.walk_rays(rays, raster.reach_m, _STEP * cell_m, _SHORT * cell_m, cell_m, free)
    ground = _cells(points[near & (normals[:, 2] > _LYING) & (height < _ABOVE_GROUND_M), :2], cell_m)
    for cells, value in ((ground, True), (taken, False)):
        i, j = cells.astype(np.int64).T + half
        free[i, j] = value
    facing = np.asarray(facing / np.linalg.norm(facing, axis=1, keepdims=True), np.float64)
    middles = np.asarray((np.argwhere(free) - half) * cell_m, np.float64)
    return WallMap(T, walls, facing, taken * cell_m, middles)


def _cells(places: Array, cell_m: float) -> Array:
    """Cells (N, 2), from the middle on, of places (N, 2) [m]; what lies on a border is in the same one for kernels."""
    return np.asarray(np.floor(places / cell_m + 0.5))
