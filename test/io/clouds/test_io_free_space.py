"""Free directions of organised clouds: read off the rows, told only by +inf, and only where rows are rows of beams."""

from __future__ import annotations

import numpy as np
import pytest
from cloud_messages import Layout as CloudForm
from cloud_messages import pack, xyz_columns
from scipy.spatial.transform import Rotation

from svc_ros.io.clouds.free_space import free_directions
from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud
from svc_ros.simulation.sensors import LidarModel, lidar_model

INF, NAN = np.full(3, np.inf), np.full(3, np.nan)
SENSOR = LidarModel("small", np.array([15.0, 4.0, -3.0, -20.0]), 360, 0.5, 100.0, 0.02, 0.0)


def beams(sensor: LidarModel = SENSOR) -> np.ndarray:
    """Ray directions (B, columns, 3), row by row."""
    return sensor.directions().reshape(sensor.columns, sensor.num_beams, 3).swapaxes(0, 1)


def ranges(rays: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points at uneven distances along the rays."""
    return rays * np.random.default_rng(seed).uniform(3.0, 40.0, rays.shape[:2])[..., None]


def read(points: np.ndarray, **values: object) -> CloudReading:
    """Through a real message; points (H, W, 3)."""
    cloud = pack(xyz_columns(points), CloudForm(height=len(points)))
    return scan_from_cloud(cloud.message(), **values)


def angles_deg(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    cross = np.linalg.norm(np.cross(found, wanted), axis=1)
    return np.degrees(np.arctan2(cross, (found * wanted).sum(1)))


@pytest.mark.parametrize("gap", [slice(100, 101), slice(40, 190), slice(0, 50), slice(330, 360)], ids=str)
@pytest.mark.parametrize("turn", [1, -1], ids=["clockwise", "counterclockwise"])
def test_directions_are_those_of_the_beams(gap, turn):
    """The sensor's ranges are noisy in nothing but distance; a gap may lie across the seam of the turn."""
    rays = beams()[:, ::turn]
    points = ranges(rays)
    points[1:3, gap] = INF
    reading = read(points)
    wanted = rays[1:3, gap].reshape(-1, 3)
    found = reading.scan.free_directions
    assert found.shape == wanted.shape
    assert angles_deg(found, wanted).max() < 0.01
    assert (reading.num_out_of_range, reading.num_dropped_nan, reading.num_dropped_zero) == (len(wanted), 0, 0)
    assert len(reading.scan) == points.shape[0] * points.shape[1] - len(wanted)
    assert reading.nan_ratio == len(wanted) / reading.num_points


def test_nan_zero_and_minus_inf_tell_nothing():
    points = ranges(beams())
    points[0, 10:20], points[1, 10:25], points[2, 10:30], points[3, 5] = NAN, 0.0, -np.inf, (np.inf, 1.0, 1.0)
    reading = read(points)
    assert reading.scan.free_directions is None
    assert (reading.num_out_of_range, reading.num_dropped_nan, reading.num_dropped_zero) == (0, 31, 15)
    points[0, 12] = INF
    beside = read(points)
    assert angles_deg(beside.scan.free_directions, beams()[0, 12:13]).max() < 0.01
    assert (beside.num_out_of_range, beside.num_dropped_nan) == (1, 30)


def test_a_row_with_hardly_a_return_tells_nothing():
    points = ranges(beams())
    points[0] = INF
    points[0, ::40] = ranges(beams())[0, ::40]
    points[2, 30:60] = INF
    reading = read(points)
    assert reading.num_out_of_range == 351 + 30
    np.testing.assert_array_less(angles_deg(reading.scan.free_directions, beams()[2, 30:60]), 0.01)


def test_an_unorganised_cloud_tells_nothing():
    points = ranges(beams()).reshape(1, -1, 3)
    points[0, 50:90] = INF
    reading = read(points)
    assert (reading.scan.free_directions, reading.num_out_of_range) == (None, 40)


def test_part_of_a_turn_is_read_between_its_returns_only():
    rays = beams()[:, 100:220]
    points = ranges(rays)
    points[1, :10], points[1, 50:60], points[1, 115:] = INF, INF, INF
    found = read(points).scan.free_directions
    assert len(found) == 10
    assert angles_deg(found, rays[1, 50:60]).max() < 0.01


def test_staggered_rows_and_an_origin_beside_the_frames():
    """Real sensors fire their rows at azimuths of their own; the cloud may be given in the vehicle's frame."""
    stagger = Rotation.from_euler("z", [[3.1], [-3.1], [1.0], [-1.0]], degrees=True)
    rays = np.stack([turn.apply(row) for turn, row in zip(stagger, beams(), strict=True)])
    origin, points = np.array([0.4, 0.0, 1.8]), ranges(rays)
    points[1:, 200:260] = np.nan
    points[1:, 220:240] = np.inf
    found = read(points + origin, sensor_origin=origin).scan.free_directions
    assert angles_deg(found, rays[1:, 220:240].reshape(-1, 3)).max() < 0.01


@pytest.mark.parametrize("name", ["camera", "on_its_side", "unknown_origin"])
def test_rows_that_are_no_beams_of_one_elevation_tell_nothing(name):
    rays, shift = beams(), 0.0
    if name == "camera":
        x, y = np.meshgrid(np.linspace(-0.6, 0.6, 64), np.linspace(-0.4, 0.4, 48))
        rays = np.stack([x, y, np.ones_like(x)], -1)
    elif name == "on_its_side":
        rays = rays @ Rotation.from_euler("x", 90, degrees=True).as_matrix().T
    else:
        shift = np.array([0.0, 0.0, 4.0])
    points = ranges(rays) + shift
    points[1:3, 30:45] = INF
    reading = read(points)
    assert reading.num_out_of_range == 30
    assert reading.scan.free_directions is None


def test_a_simulated_scan_as_an_organised_cloud_tells_its_own_directions():
    """Noise, lost returns and sky, with the columns of a real sensor."""
    rays = beams(lidar_model("OS1-64"))
    rng = np.random.default_rng(1)
    distance = 12.0 + 4.0 * np.sin(np.arange(1024) / 40.0) + rng.normal(scale=0.03, size=(64, 1024))
    points = (rays * distance[..., None]).astype(np.float32)
    free = (np.arange(64)[:, None] < 20 + 15 * np.sin(np.arange(1024) / 90.0)) | (rng.random((64, 1024)) < 0.01)
    points[free] = np.inf
    found = free_directions(points.reshape(-1, 3).astype(float), free.ravel(), 64, 1024)
    told = [row for row in range(64) if (~free[row]).sum() >= 0.05 * 1024]
    wanted = rays[told][free[told]]
    assert found.shape == wanted.shape
    assert len(told) > 50
    assert angles_deg(found, wanted).max() < 0.02
