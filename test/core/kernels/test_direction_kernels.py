"""Cells around a direction: every direction that a cone holds is in one of them, wherever it points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core.kernels.direction import fill_bounds, fill_direction_cells

ROWS, COLUMNS = 573, 180


def cells_of(points: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    cells = np.empty(len(points), np.int64)
    fill_direction_cells(np.ascontiguousarray(points), rows, columns, cells)
    return cells % rows, cells // rows


def bounds_of(points: np.ndarray, radius: float, max_sine: float, rows: int, columns: int) -> np.ndarray:
    bounds, sizes = np.empty((4, len(points)), np.int32), np.empty((3, len(points)))
    fill_bounds(*np.ascontiguousarray(points.T), radius, max_sine, float(rows), float(columns), bounds, sizes)
    distance = np.linalg.norm(points, axis=1)
    offset = np.minimum(radius, distance * max_sine)
    np.testing.assert_allclose(sizes, [distance**2, distance, offset**2], rtol=1e-12)
    return bounds


def around(point: np.ndarray, half_angle: float, num: int, rng: np.random.Generator) -> np.ndarray:
    """Directions (num, 3) no farther than the half angle from the point's, most of them at its very end."""
    across = np.cross(point, rng.normal(size=(num, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    share = np.where(rng.random(num) < 0.7, 1.0, rng.random(num))
    return Rotation.from_rotvec(across * (share * half_angle * (1.0 - 1e-9))[:, None]).apply(point)


def special_points() -> np.ndarray:
    """Poles, the seam, borders of quarters, and points so near that the cone is half of all directions."""
    near_poles = [[1e-9, 0, 5], [0.01, -0.01, 5], [0, 1e-3, -5], [0, 0, 3], [0, 0, -3]]
    seam = [[5, 0, 0], [5, 1e-12, 0], [5, -1e-12, 0], [5, -0.01, 1], [0, 5, 0], [-5, 0, 0], [0, -5, 0.2]]
    return np.array([*near_poles, *seam, [0.2, 0.1, 0.05], [0.0, 0.0, 0.21]], float)


@pytest.mark.parametrize(("rows", "columns"), [(ROWS, COLUMNS), (7, 5), (1, 1)])
@pytest.mark.parametrize(("radius", "max_sine"), [(0.15, 0.007), (0.3, 0.03), (0.2, 0.9), (2.0, 1.0)])
def test_all_directions_of_the_cone_are_in_its_cells(radius, max_sine, rows, columns):
    rng = np.random.default_rng(0)
    points = np.concatenate((rng.normal(size=(60, 3)) * rng.uniform(0.3, 30, (60, 1)), special_points()))
    points = points[np.linalg.norm(points, axis=1) > radius]
    bounds = bounds_of(points, radius, max_sine, rows, columns)
    for point, (first_row, last_row, first, last) in zip(points, bounds.T.tolist(), strict=True):
        distance = np.linalg.norm(point)
        row, column = cells_of(around(point, np.arcsin(min(radius / distance, max_sine)), 60, rng), rows, columns)
        assert (row >= first_row).all()
        assert (row <= last_row).all()
        assert ((column - first) % columns <= last - first).all()
        assert 0 <= first_row <= last_row < rows
        assert first <= last < first + columns
        assert -columns <= first < columns


def test_a_narrow_cone_at_the_horizon_needs_few_cells():
    rng = np.random.default_rng(1)
    azimuth = rng.uniform(0, 2 * np.pi, 500)
    points = 20.0 * np.column_stack((np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.2, 0.2, 500)))
    first_row, last_row, first, last = bounds_of(points, 0.15, 0.005, ROWS, COLUMNS)
    assert (last - first).max() <= 1
    assert (last_row - first_row).max() <= 5  # 0.57 degrees, in cells of 0.2 degrees
