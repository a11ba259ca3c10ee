"""Search structures equal brute force, also where cells end, below zero and far away."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scan_cases import random_scan

from svc_ros.core.scans.neighbours import DirectionGrid, NearestGrid, direction_grid, nearest_grid

RNG = np.random.default_rng(8)


def check_against_brute_force(points: np.ndarray, queries: np.ndarray, radius: float) -> np.ndarray:
    """The same queries find a point, and one that is as near as the nearest, but for a thousandth of the radius."""
    found = NearestGrid.build(points, radius).nearest(queries)
    expected = reference.nearest_within(queries, points, radius)
    np.testing.assert_array_equal(found >= 0, expected >= 0)
    near = found >= 0
    distance, least = (np.linalg.norm(queries[near] - points[idx[near]], axis=1) for idx in (found, expected))
    np.testing.assert_allclose(distance, least, atol=1e-3 * radius)
    return found


@pytest.mark.parametrize("radius", [0.1, 0.6, 3.0])
@pytest.mark.parametrize("centre", [(0, 0, 0), (-50, -70, -3), (3000, -8000, 200)])
def test_nearest_within_equals_brute_force(centre, radius):
    points, queries = (RNG.normal(size=(n, 3)) * 2 + centre for n in (500, 400))
    found = check_against_brute_force(points, queries, radius)
    assert (found >= 0).any()


def test_points_and_queries_on_the_borders_of_cells():
    lattice = np.stack(np.meshgrid(*[np.arange(-3, 4) * 0.5] * 3), -1).reshape(-1, 3)
    check_against_brute_force(lattice, lattice, 0.5)
    check_against_brute_force(lattice, lattice + np.array([0.25, 0, 0]), 0.5)  # two at the same distance
    check_against_brute_force(lattice, np.nextafter(lattice, -np.inf), 0.5)


def test_the_radius_itself_is_outside():
    assert NearestGrid.build(np.zeros((1, 3)), 0.5).nearest(np.array([[0.5, 0, 0], [0.4999, 0, 0]])).tolist() == [-1, 0]


def test_equal_points_answer_with_one_of_them():
    points = np.repeat(RNG.normal(size=(20, 3)), 5, axis=0)
    np.testing.assert_array_equal(check_against_brute_force(points, points, 0.3) // 5, np.arange(100) // 5)


def test_the_nearest_of_a_crowd_is_found_wherever_the_cells_begin():
    points = RNG.uniform(-1, 1, size=(3000, 3)) * (4, 4, 1)
    for k in range(1, 40):  # runs of all lengths, beginning and ending in all lanes
        check_against_brute_force(points[: 7 * k], points[:50] + 0.03, 0.5)


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9])
def test_queries_far_away_have_no_neighbour(far):
    grid = NearestGrid.build(RNG.normal(size=(100, 3)), 0.3)
    queries = np.vstack([far * np.eye(3), -far * np.eye(3)])
    assert (grid.nearest(queries) == -1).all()


def test_empty_inputs():
    assert NearestGrid.build(np.zeros((0, 3)), 0.3).nearest(np.zeros((2, 3))).tolist() == [-1, -1]
    assert NearestGrid.build(np.zeros((2, 3)), 0.3).nearest(np.zeros((0, 3))).shape == (0,)


def cells_by_hand(points: np.ndarray, rows: int, columns: int) -> np.ndarray:
    x, y, z = points.T
    quarter = np.floor(np.degrees(np.arctan2(y, x)) / 90.0) % 4
    ahead, aside = (np.abs(np.where(quarter % 2 == 0, *pair)) for pair in ((x, y), (y, x)))
    row = np.clip(np.floor((z / np.linalg.norm(points, axis=1) / 2 + 0.5) * rows), 0, rows - 1)
    part = np.divide(aside, ahead + aside, out=np.zeros(len(points)), where=ahead + aside > 0)
    column = np.clip(np.floor((quarter + part) / 4 * columns), 0, columns - 1)
    return (column * rows + row).astype(np.int64)


def test_direction_grid_holds_every_point_in_its_cell():
    special = np.array([[0, 0, 1], [0, 0, -1], [-1, 0, 0], [-1, -0.0, 0], [1, 0, 0], [-1, 1e-12, 0], [-1, -1e-12, 0.0]])
    points = np.concatenate([RNG.normal(size=(500, 3)) * 10, special])
    normals = RNG.normal(size=points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    grid = DirectionGrid.build(points, normals)
    assert sorted(grid.order) == list(range(len(points)))
    np.testing.assert_array_equal(grid.lines[:, :3], points[grid.order])
    np.testing.assert_array_equal(grid.surfaces[:, :3], normals[grid.order])
    np.testing.assert_allclose(grid.lines[:, 3], np.linalg.norm(grid.lines[:, :3], axis=1))
    incidence = np.arccos(np.abs(np.einsum("ij,ij->i", grid.lines[:, :3], grid.surfaces[:, :3]) / grid.lines[:, 3]))
    np.testing.assert_allclose(grid.surfaces[:, 3], np.tan(incidence), rtol=1e-6)
    cells = np.repeat(np.arange(grid.rows * grid.columns), np.diff(grid.cell_starts))
    np.testing.assert_array_equal(cells, cells_by_hand(grid.lines[:, :3], grid.rows, grid.columns))


def test_points_at_the_sensor_are_in_no_cell():
    points = np.array([[1.0, 0, 0], [0, 0, 0], [0, 1, 0], [1e-12, 0, 0]])
    assert sorted(DirectionGrid.build(points, points).order) == [0, 2]


def test_structures_are_built_once_a_scan():
    scan = random_scan(100, 1, origin=(1, 2, 3))
    assert nearest_grid(scan, 0.5) is nearest_grid(scan, 0.5)
    assert nearest_grid(scan, 0.5) is not nearest_grid(scan, 0.6)
    assert direction_grid(scan) is direction_grid(scan)
    grid = direction_grid(scan)
    np.testing.assert_array_equal(grid.lines[:, :3], (scan.points - (1, 2, 3))[grid.order])
