"""From a raw scan to the thinned points and oriented normals that every later stage looks at."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import PreprocessConfig
from svc_ros.core.errors import ConfigError, TooFewPointsError
from svc_ros.core.kernels import raw_scan as raw_scan_kernels
from svc_ros.core.kernels import surface as surface_kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.range_image import build_range_image
from svc_ros.core.scan import Array, PreparedScan, Scan
from svc_ros.core.scans.neighbours import NearestGrid, RadiusGrid
from svc_ros.core.scans.oddities import explain_few_points

_SECTOR_DEG = 0.5
_EVERY_SECTOR = 6  # a sixth of the points shows the spacing as well as all of them
_ENOUGH_POINTS, _MOST_SPARED = 1_000_000, 20  # from twice as many on, fewer sectors; never fewer than six of them
_TURN_STEPS, _MARGIN = 2048, 1e-3  # a step is far less than a sector; of a sector, more than arithmetic errs
_SAME_BEAM_DEG, _NEXT_SECTOR = 0.05, 500.0  # keys of two sectors differ by more, those of one by less
_COLUMN_VOXELS = 4.0  # edge of the columns that sort the points
_FREE_CELL = float(np.radians(1.0))  # edge on the unit sphere: one free direction a cell, no return as near to it


def preprocess(scan: Scan, config: PreprocessConfig) -> PreparedScan:
    """Crop by range from the sensor, thin on a voxel grid, estimate normals towards the sensor.

    Raises TooFewPointsError where fewer than `config.min_points` points are left.
    """
    cropped = crop_range(scan.points, scan.sensor_origin, config)
    points = thin_on_voxel_grid(cropped, config.voxel_size_m)
    if len(points) < config.min_points:
        raise TooFewPointsError(
            f"scan {scan.frame_id!r} at {scan.stamp_ns} ns: expected at least {config.min_points} points after "
            f"the range crop ({config.min_range_m:g}-{config.max_range_m:g} m) and the voxel grid "
            f"({config.voxel_size_m:g} m), found {len(points)} (of {len(scan)} raw points, {len(cropped)} in range): "
            f"{explain_few_points(scan.points, scan.sensor_origin, config)}"
        )
    normals = estimate_normals(points, scan.sensor_origin, config)
    spacing = estimate_beam_spacing_deg(cropped, scan.sensor_origin)
    return PreparedScan(
        points, normals, scan.sensor_origin, config.voxel_size_m, scan.stamp_ns, scan.frame_id, spacing,
        thin_free_directions(scan), build_range_image(scan.points, scan.sensor_origin, config.min_range_m, spacing),
    )  # fmt: skip


def crop_range(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Keep the points (N, 3) [m] whose range from the sensor lies within the configured limits and is not zero."""
    kept = np.empty_like(points)
    num = raw_scan_kernels.copy_in_range(points, sensor_origin, config.min_range_m**2, config.max_range_m**2, kept)
    return kept[:num]


def estimate_beam_spacing_deg(points: Array, sensor_origin: Array) -> float:
    """Median angle [deg] between vertically neighbouring beams of raw points (N, 3).

    Looks into narrow azimuth sectors, where a spinning sensor or a depth image is a vertical line of beams. 0 where
    no sector holds two of them.
    """
    every = _EVERY_SECTOR * min(max(len(points) // _ENOUGH_POINTS, 1), _MOST_SPARED)
    keys = np.empty(len(points))
    num = raw_scan_kernels.fill_elevations(points, sensor_origin, _SECTOR_DEG, every, _maybe_in_sector(every), keys)
    gap = np.diff(np.sort(keys[:num]))
    gap = gap[(gap > _SAME_BEAM_DEG) & (gap < _NEXT_SECTOR)]
    return float(np.median(gap)) if len(gap) else 0.0


@lru_cache(maxsize=8)
def _maybe_in_sector(every: int) -> NDArray[np.bool_]:
    """Table (4, _TURN_STEPS + 1) of `fill_elevations`: whether a share of a quadrant touches a sector that counts."""
    share = np.minimum(np.arange(_TURN_STEPS + 2) / _TURN_STEPS, 1.0)
    angle = np.degrees(np.arctan2(share, 1.0 - share))
    quadrants = np.array([angle, 180.0 - angle, -angle, angle - 180.0]) / _SECTOR_DEG
    one, other = quadrants[:, :-1], quadrants[:, 1:]
    ends = np.stack((np.minimum(one, other) - _MARGIN, np.maximum(one, other) + _MARGIN))
    return np.asarray((np.floor(ends) % every == 0).any(0))


def thin_on_voxel_grid(points: Array, voxel_size_m: float) -> Array:
    """Mean point of every occupied voxel, (K, 3) [m], the same bits whatever the order of the points.

    Open3D's grids are not used: one sums up in input order, the other changes the order of points from run to run.
    Raises ConfigError where the voxels are too small to be counted over the scan's extent.
    """
    num = len(points)
    if num == 0:
        return np.zeros((0, 3))
    corner = np.array([axis.min() for axis in points.T]) - 0.5 * voxel_size_m
    extent = np.floor((np.array([axis.max() for axis in points.T]) - corner) / voxel_size_m) + 1
    if np.prod(extent) >= 2.0**62:
        raise ConfigError(f"preprocess.voxel_size_m: {voxel_size_m:g} m is too small for a scan of {extent} voxels")
    cells, fractions, counts = np.empty((num, 3)), np.empty((num, 3), np.int64), np.empty(num, np.int64)
    num = raw_scan_kernels.sum_in_cells(
        points, corner, voxel_size_m, extent.astype(np.int64), cells, fractions, counts
    )  # fmt: skip
    mean = fractions[:num] / (raw_scan_kernels.FRACTION_STEPS * counts[:num, None])
    return _sort_points(corner + voxel_size_m * (cells[:num] + mean), _COLUMN_VOXELS * voxel_size_m)


def _sort_points(points: Array, edge_m: float) -> Array:
    """Column by column, each upwards: what lies together in space does so in memory. Equal places by y, then x."""
    corner, height = points.min(0), float(np.ptp(points[:, 2])) + edge_m
    i, j = np.floor((points[:, :2] - corner[:2]) / edge_m).T
    place = i * (j.max() + 1) + j + (points[:, 2] - corner[2]) / height
    order = np.argsort(place)
    place = place[order]
    same = np.concatenate([[False], place[1:] == place[:-1], [False]])
    tied = np.flatnonzero(same[1:] | same[:-1])  # only these need more than the first number
    order[tied] = order[tied][np.lexsort((*points[order[tied]].T, place[tied]))]
    return points[order]


def thin_free_directions(scan: Scan) -> Array:
    """Unit directions (F, 3), about a degree apart, in which the scan's sensor met nothing; empty where none is told.

    A direction with a return beside it says nothing: one beam's return may be lost, or the beam passes an edge.
    """
    if scan.free_directions is None or len(scan.free_directions) == 0:
        return np.zeros((0, 3))
    thinned = _units(thin_on_voxel_grid(scan.free_directions, _FREE_CELL))
    seen = scan.points - scan.sensor_origin
    returns = _units(seen[np.square(seen).sum(1) > 0])
    return thinned[NearestGrid.build(returns, _FREE_CELL).nearest(thinned) < 0]


def _units(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def estimate_normals(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Unit normals (K, 3) of points (K, 3) [m], turned towards the sensor; as Open3D's, in a third of its time.

    Points without a plane around them (fewer than three neighbours, themselves included) face the sensor.
    """
    grid = RadiusGrid.build(points, config.normal_radius_m)
    tables = (grid.shape, grid.points, grid.column_low, grid.column_first, grid.starts)
    sorted_normals, sorted_known = np.empty((len(points), 3)), np.empty(len(points), np.bool_)

    def fit(part: slice) -> None:
        surface_kernels.fit_normals(
            part.start, part.stop, config.normal_radius_m, config.normal_max_neighbours - 1, tables,
            sorted_normals, sorted_known,
        )  # fmt: skip

    on_all_processors(fit, in_parts(len(points)))
    normals, known = np.empty_like(sorted_normals), np.empty_like(sorted_known)
    normals[grid.order], known[grid.order] = sorted_normals, sorted_known
    return _turn_to_sensor(normals, known, sensor_origin - points)


def _turn_to_sensor(normals: Array, known: NDArray[np.bool_], to_sensor: Array) -> Array:
    """Normals (K, 3) on the side of the sensor, whose direction is theirs where they are not known."""
    away = np.einsum("ij,ij->i", normals, to_sensor) < 0
    turned = np.where(away[:, None], -normals, normals)
    unknown = to_sensor[~known]
    turned[~known] = unknown / np.maximum(np.linalg.norm(unknown, axis=1, keepdims=True), 1e-12)
    return turned
