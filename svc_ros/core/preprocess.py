"""From a raw scan to the thinned points and oriented normals that every later stage looks at."""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import PreprocessConfig
from svc_ros.core.errors import TooFewPointsError
from svc_ros.core.scan import Array, PreparedScan, Scan


def preprocess(scan: Scan, config: PreprocessConfig) -> PreparedScan:
    """Crop by range from the sensor, thin on a voxel grid, estimate normals towards the sensor.

    Raises TooFewPointsError where fewer than `config.min_points` points are left.
    """
    cropped = crop_range(scan.points, scan.sensor_origin, config)
    points = thin_on_voxel_grid(cropped, config.voxel_size_m)
    if len(points) < config.min_points:
        raise TooFewPointsError(
            f"scan {scan.frame_id!r} at {scan.stamp_ns} ns: expected at least {config.min_points} points after the range "
            f"crop ({config.min_range_m:g}-{config.max_range_m:g} m) and the voxel grid ({config.voxel_size_m:g} m), "
            f"found {len(points)} (of {len(scan.points)} raw points, {len(cropped)} in range)"
        )
    normals = estimate_normals(points, scan.sensor_origin, config)
    return PreparedScan(points, normals, scan.sensor_origin, config.voxel_size_m, scan.stamp_ns, scan.frame_id)


def crop_range(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Keep the points (N, 3) [m] whose range from the sensor lies within the configured limits."""
    sq_range = np.square(points - sensor_origin).sum(1)
    keep = (sq_range >= config.min_range_m**2) & (sq_range <= config.max_range_m**2)
    return points[keep]


def thin_on_voxel_grid(points: Array, voxel_size_m: float) -> Array:
    """Mean point of every occupied voxel, (K, 3) [m], in an order that does not depend on the input's order.

    Open3D's tensor grid is not used: its parallel hash map changes the order of points from run to run.
    """
    import open3d as o3d

    if len(points) == 0:
        return np.zeros((0, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    thinned = np.asarray(cloud.voxel_down_sample(voxel_size_m).points)
    return thinned[np.lexsort(thinned.T)]


def estimate_normals(points: Array, sensor_origin: Array, config: PreprocessConfig) -> Array:
    """Unit normals (K, 3) of points (K, 3) [m], turned towards the sensor.

    Points without a plane around them (fewer than three neighbours) face the sensor.
    """
    import open3d as o3d

    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.ascontiguousarray(points)))
    cloud.estimate_normals(max_nn=config.normal_max_neighbours, radius=config.normal_radius_m)
    normals = cloud.point.normals.numpy().astype(np.float64, copy=True)
    to_sensor = sensor_origin - points
    to_sensor /= np.maximum(np.linalg.norm(to_sensor, axis=1, keepdims=True), 1e-12)
    no_plane = ~np.isfinite(normals).all(1) | (normals == (0.0, 0.0, 1.0)).all(1)  # Open3D's answer without neighbours
    normals[no_plane] = to_sensor[no_plane]
    away = np.einsum("ij,ij->i", normals, to_sensor) < 0
    normals[away] *= -1.0
    return normals
