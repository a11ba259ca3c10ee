"""From a raw scan to the thinned points and oriented normals that every later stage looks at."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from svc_ros.core.config import PreprocessConfig
from svc_ros.core.errors import ConfigError, TooFewPointsError
from svc_ros.core.neighbours import RadiusGrid
from svc_ros.core.scan import Array, IndexArray, PreparedScan, Scan

_FRACTION_STEPS = 2.0**32  # a point's place inside its voxel, in steps of a nanometre or less

_SECTOR_DEG = 0.5
_EVERY_SECTOR = 6  # a sixth of the points shows the spacing as well as all of them
_SAME_BEAM_DEG = 0.05
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
            f"({config.voxel_size_m:g} m), found {len(points)} (of {len(scan)} raw points, {len(cropped)} in range)"
        )
    normals = estimate_normals(points, scan.sensor_origin, config)
    spacing = estimate_beam_spacing_deg(cropped - scan.sensor_origin)
    return PreparedScan(
        points, normals, scan.sensor_origin, config.voxel_size_m, scan.stamp_ns, scan.frame_id, spacing,
        thin_free_directions(scan),
    )  # fmt: skip


def crop_range(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Keep the points (N, 3) [m] whose range from the sensor lies within the configured limits and is not zero."""
    sq_range = np.square(points - sensor_origin).sum(1)
    keep = (sq_range >= config.min_range_m**2) & (sq_range <= config.max_range_m**2) & (sq_range > 0)
    return points[keep]


def estimate_beam_spacing_deg(relative_points: Array) -> float:
    """Median angle [deg] between vertically neighbouring beams of raw points (N, 3), given relative to the sensor.

    Looks into narrow azimuth sectors, where a spinning sensor or a depth image is a vertical line of beams. 0 where
    no sector holds two of them.
    """
    x, y, z = relative_points.T
    sector = np.floor(np.degrees(np.arctan2(y, x)) / _SECTOR_DEG).astype(np.int64)
    looked_at = sector % _EVERY_SECTOR == 0
    elevation = np.degrees(np.arctan2(z[looked_at], np.hypot(x[looked_at], y[looked_at])))
    sector = sector[looked_at]
    order = np.lexsort((elevation, sector))
    gap = np.diff(elevation[order])[np.diff(sector[order]) == 0]
    gap = gap[gap > _SAME_BEAM_DEG]
    return float(np.median(gap)) if len(gap) else 0.0


def thin_on_voxel_grid(points: Array, voxel_size_m: float) -> Array:
    """Mean point of every occupied voxel, (K, 3) [m], the same bits whatever the order of the points.

    Open3D's grids are not used: one sums up in input order, the other changes the order of points from run to run.
    Raises ConfigError where the voxels are too small to be counted over the scan's extent.
    """
    if len(points) == 0:
        return np.zeros((0, 3))
    corner = points.min(0) - 0.5 * voxel_size_m
    position = (points - corner) / voxel_size_m
    cell = np.floor(position)
    key = _cell_numbers(cell.astype(np.int64), voxel_size_m)
    _, first, row = np.unique(key, return_index=True, return_inverse=True)
    # Sums of whole numbers below 2^53 are exact, so that their order does not matter.
    fraction = np.rint((position - cell) * _FRACTION_STEPS)
    sums = np.stack([np.bincount(row, fraction[:, axis], len(first)) for axis in range(3)], 1)
    mean = sums / (_FRACTION_STEPS * np.bincount(row)[:, None])
    thinned = corner + voxel_size_m * (cell[first] + mean)
    return thinned[np.lexsort(thinned.T)]


def thin_free_directions(scan: Scan) -> Array:
    """Unit directions (F, 3), about a degree apart, in which the scan's sensor met nothing; empty where none is told.

    A direction with a return beside it says nothing: one beam's return may be lost, or the beam passes an edge.
    """
    if scan.free_directions is None or len(scan.free_directions) == 0:
        return np.zeros((0, 3))
    thinned = _units(thin_on_voxel_grid(scan.free_directions, _FREE_CELL))
    seen = scan.points - scan.sensor_origin
    returns = _units(seen[np.square(seen).sum(1) > 0])
    return thinned[RadiusGrid.build(returns, _FREE_CELL).nearest(thinned) < 0]


def _units(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _cell_numbers(cell: IndexArray, voxel_size_m: float) -> IndexArray:
    """One number (N,) for each cell (N, 3), counted through the box around all of them."""
    extent = cell.max(0) + 1
    if np.prod(extent.astype(np.float64)) >= 2.0**62:
        raise ConfigError(f"preprocess.voxel_size_m: {voxel_size_m:g} m is too small for a scan of {extent} voxels")
    return np.asarray((cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2])


def estimate_normals(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Unit normals (K, 3) of points (K, 3) [m], turned towards the sensor.

    Points without a plane around them (fewer than three neighbours) face the sensor.
    """
    import open3d as o3d

    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(np.array(points, np.float64, order="C")))
    cloud.estimate_normals(max_nn=config.normal_max_neighbours, radius=config.normal_radius_m)
    normals: Array = cloud.point.normals.numpy().astype(np.float64, copy=True)
    to_sensor = sensor_origin - points
    to_sensor /= np.maximum(np.linalg.norm(to_sensor, axis=1, keepdims=True), 1e-12)
    no_plane = _find_without_plane(points, normals, config.normal_radius_m)
    normals[no_plane] = to_sensor[no_plane]
    away = np.einsum("ij,ij->i", normals, to_sensor) < 0
    normals[away] *= -1.0
    return normals


def _find_without_plane(points: Array, normals: Array, radius_m: float) -> IndexArray:
    """Indices of points with fewer than three neighbours, themselves included.

    Open3D answers (0, 0, 1) for them, and for every point of a level floor as well: those must be told apart.
    """
    suspects = np.flatnonzero(~np.isfinite(normals).all(1) | (np.abs(normals[:, 2]) == 1.0))
    if len(suspects) == 0:
        return suspects
    num_near = cKDTree(points).query_ball_point(points[suspects], radius_m, return_length=True)
    return suspects[np.asarray(num_near) < 3]
