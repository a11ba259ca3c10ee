"""Maps of walls: kernels equal to their slow twins, and cells that say what a sensor saw and what it saw through."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import reference_wall_maps as reference
from level_cases import EYE_M, field, plane, room, seen, street, tilt
from scan_cases import prepared

from svc_ros.core.kernels import wall_map as kernels
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans import wall_map as stage
from svc_ros.core.scans.levelling import find_level
from svc_ros.core.scans.wall_map import Raster, WallMap, choose_raster, wall_map

LEVEL = np.eye(4)
RASTER = Raster(0.5, 96)
CELL, SIZE = 0.5, 16
ANGLES = [0.0, 0.3, np.pi / 6, np.pi / 4, np.pi / 2, 2.0, np.pi, -1.2]


def map_of_scan(scan: PreparedScan) -> WallMap:
    return wall_map(scan, find_level(scan).T_level_scan, RASTER)


def cases() -> dict[str, np.ndarray]:
    """Places (N, 2) [m]; the map is 8 m wide."""
    rng = np.random.default_rng(0)
    lattice = np.stack(np.meshgrid(np.arange(-8, 8), np.arange(-8, 8)), -1).reshape(-1, 2) * CELL
    return {
        "none": np.zeros((0, 2)), "one": np.array([[1.3, -2.1]]), "at_the_sensor": np.zeros((3, 2)),
        "one_cell": rng.uniform(-0.24, 0.24, (200, 2)), "many": rng.uniform(-4, 4, (400, 2)),
        "middles": lattice, "on_borders": lattice + 0.5 * CELL,
        "about_borders": np.nextafter(lattice + 0.5 * CELL, rng.choice([-np.inf, np.inf], lattice.shape)),
        "outside": rng.uniform(-30, 30, (300, 2)), "far_outside": rng.normal(size=(50, 2)) * 1e6,
    }  # fmt: skip


CASES = cases()


# Kernels


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("case", CASES)
def test_images_are_those_of_every_cell_alone(case, angle):
    """Every case in turn as the walls, the taken and the free cells; what leaves on one side comes in on the other."""
    rng, names = np.random.default_rng(1), list(CASES)
    k = names.index(case)
    points, taken, free = (CASES[names[(k + step) % len(names)]] for step in (0, 3, 4))
    facing = rng.uniform(0, 2 * np.pi, len(points))
    normals = np.column_stack((np.cos(facing), np.sin(facing)))
    found = np.full((2, SIZE, SIZE), 7j, np.complex64)
    kernels.draw(points, normals, taken, free, np.cos(angle), np.sin(angle), CELL, *found)
    expected = reference.images(points, normals, taken, free, (np.cos(angle), np.sin(angle)), (CELL, SIZE))
    np.testing.assert_allclose(found[0], expected[0], atol=2e-5)
    np.testing.assert_array_equal(found[1], expected[1])


def test_a_wall_of_one_point_counts_half_and_walls_that_face_two_ways_for_nothing():
    points = np.array([[0.0, 0], [1.0, 0], [1.1, 0], [2.0, 0], [2.1, 0]])
    normals = np.array([[0.0, 1], [1, 0], [1, 0], [0, 1], [0, -1]])
    images = np.empty((2, SIZE, SIZE), np.complex64)
    kernels.draw(points, normals, points[:0], points[:0], 1.0, 0.0, CELL, *images)
    np.testing.assert_array_equal(images[0][[0, 2, 4], 0], [0.5j, 1.0, 0.0])
    assert np.count_nonzero(images[0]) == 2
    assert not images[1].any()


@pytest.mark.parametrize("reach", [0.0, 1.0, 3.6])
@pytest.mark.parametrize(("step", "short"), [(0.7, 1.5), (0.3, 0.0), (1.0, 0.5)])
@pytest.mark.parametrize("case", CASES)
def test_rays_free_the_cells_that_they_pass(case, step, short, reach):
    ends, free = CASES[case], np.zeros((SIZE, SIZE), bool)
    kernels.walk_rays(ends, reach, step * CELL, short * CELL, CELL, free)
    found = {tuple(cell) for cell in (np.argwhere(free) - SIZE // 2).tolist()}
    assert found == reference.crossed_cells(ends, reach, step * CELL, short * CELL, CELL)
    assert all(np.hypot(*cell) * CELL <= reach + CELL for cell in found)


def scores() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    slope = np.add.outer(np.arange(12.0), np.arange(12.0))
    return {
        "random": rng.normal(size=(24, 24)), "ties": rng.integers(0, 3, (20, 20)).astype(float),
        "flat": np.zeros((6, 6)), "one_cell": np.ones((1, 1)), "two_by_two": np.array([[1.0, 2], [2, 1]]),
        "slope": slope, "on_the_edge": np.where(slope == 0, 50.0, -slope), "all_negative": -1.0 - rng.random((9, 9)),
        "two_equal": np.where((slope == 3) & (np.arange(12) % 3 == 0), 1.0, 0.0),
    }  # fmt: skip


SCORES = scores()


@pytest.mark.parametrize("num", [1, 2, 12, 50])
@pytest.mark.parametrize("case", SCORES)
def test_peaks_are_the_highest_local_maxima_and_of_equal_ones_the_first(case, num):
    score = SCORES[case].astype(np.float32)
    cells, values = np.full((num, 2), -1, np.int64), np.zeros(num)
    kernels.find_peaks(score, cells, values)
    expected = reference.peaks(score, num)
    assert [(v, i, j) for v, (i, j) in zip(values.tolist(), cells.tolist(), strict=True)][: len(expected)] == expected
    assert (values[len(expected) :] == -np.inf).all()
    assert (cells[len(expected) :] == -1).all()


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("size", [1, 2, 6, 7])
def test_a_quarter_of_a_circle_turns_the_transform_as_it_turns_the_image(size, quarter):
    rng = np.random.default_rng(size)
    source, target = (rng.normal(size=(2, size, size)) + 1j * rng.normal(size=(2, size, size)) for _ in range(2))
    spectrum = np.empty((size, size), np.complex64)
    transformed = [np.array([reference.transform(image) for image in both]) for both in (target, source)]
    kernels.correlate(*(both.astype(np.complex64) for both in transformed), quarter, np.float32(0.3), spectrum)
    turned = [reference.transform(reference.turn_by_quarters(image, quarter)) for image in source]
    expected = transformed[0][0] * (turned[0] * 1j**quarter).conj() - 0.3 * transformed[0][1] * turned[1].conj()
    np.testing.assert_allclose(spectrum, expected, rtol=1e-4, atol=1e-3)


# Maps


def random_level_scan(T: np.ndarray) -> PreparedScan:
    """Ground, and walls of random points that face anywhere."""
    rng = np.random.default_rng(3)
    ground, high = plane((0, 0, -EYE_M), (12, 0, 0), (0, 12, 0)), (-1.0, -0.2, 0.1)
    parts = {(0.0, 0.0, 1.0): [ground]}
    for azimuth in rng.uniform(0, 2 * np.pi, 20):
        facing = (float(np.cos(azimuth)), float(np.sin(azimuth)), 0.0)
        parts[facing] = [np.column_stack((rng.uniform(-15, 15, (10, 2)), rng.choice(high, 10)))]
    return seen(parts, T)


@pytest.mark.parametrize("make", [street, room, field, random_level_scan])
@pytest.mark.parametrize("deg", [0.0, 9.0])
def test_a_map_holds_what_was_seen_and_what_was_seen_through(make, deg):
    drawn = map_of_scan(make(tilt(deg, 40.0, (3.0, -1.0, 2.0))))
    assert (np.linalg.norm(drawn.walls, axis=1) < RASTER.reach_m).all()
    np.testing.assert_allclose(np.linalg.norm(drawn.normals, axis=1), 1.0)
    for cells in (drawn.taken, drawn.free):
        named = np.round(cells / RASTER.cell_m)
        np.testing.assert_array_equal(cells, named * RASTER.cell_m)
        assert len(np.unique(named, axis=0)) == len(named)
        assert (np.abs(named) <= RASTER.size // 2 - 1).all()
    taken, free, walls = (
        {reference.cell_of(x, y, 1.0, 0.0, RASTER.cell_m) for x, y in places.tolist()}
        for places in (drawn.taken, drawn.free, drawn.walls)
    )
    assert taken == walls
    assert not taken & free
    assert free


@pytest.mark.parametrize("shift_m", [0.0, 0.25, -0.25, 0.1])
def test_a_wall_on_a_border_is_in_one_cell_for_all(shift_m):
    """Half of the cells' edges from every middle: what is taken is what a wall is drawn in."""
    walls = [plane((x + shift_m, shift_m, 0.0), (0, 3, 0), (0, 0, 1)) for x in (2.0, 3.5, -4.0)]
    ground = plane((0, 0, -EYE_M), (6, 0, 0), (0, 6, 0))
    drawn = map_of_scan(seen({(0, 0, 1): [ground], (1, 0, 0): walls}, LEVEL))
    images = np.empty((2, RASTER.size, RASTER.size), np.complex64)
    kernels.draw(drawn.walls, drawn.normals, drawn.taken, drawn.free, 1.0, 0.0, RASTER.cell_m, *images)
    np.testing.assert_array_equal(images[1] == 1.0, images[0] != 0.0)
    assert len(drawn.taken) == 39


def test_walls_are_drawn_where_they_stand_and_face_the_sensor():
    drawn = map_of_scan(street(LEVEL))
    np.testing.assert_allclose(np.abs(drawn.walls[:, 1]), 10.0)
    np.testing.assert_allclose(drawn.normals, -np.sign(drawn.walls[:, 1:]) * (0.0, 1.0), atol=1e-9)
    assert ((np.abs(drawn.taken[:, 1]) == 10.0) & (np.abs(drawn.taken[:, 0]) <= RASTER.reach_m)).all()
    assert (np.abs(drawn.free[:, 1]) < 10.0 + RASTER.cell_m).all()  # none behind the fronts


def test_what_stands_too_low_or_hangs_too_high_hides_nothing():
    """Kerbs are no walls; what hangs above the eye level is one, but it was not looked across below it."""
    ground = plane((0, 0, -EYE_M), (12, 0, 0), (0, 2, 0))
    kerb, bridge = (plane((0, 8, z - EYE_M), (4, 0, 0), (0, 0, 0.1)) for z in (0.2, 6.0))
    for wall, num in ((kerb, 0), (bridge, len(bridge))):
        drawn = map_of_scan(seen({(0, 0, 1): [ground] * 3, (0, -1, 0): [wall]}, LEVEL))
        assert len(drawn.walls) == num
        assert drawn.free[:, 1].max() <= 2.5


def test_rays_free_what_lies_before_a_wall_and_nothing_behind():
    ground, wall = plane((0, 0, -EYE_M), (3, 0, 0), (0, 2, 0)), plane((9, 0, 0), (0, 1, 0), (0, 0, 1))
    drawn = map_of_scan(seen({(0, 0, 1): [ground], (-1, 0, 0): [wall]}, LEVEL))
    before = drawn.free[(drawn.free[:, 1] == 0.0) & (drawn.free[:, 0] > 3.0), 0]
    np.testing.assert_array_equal(before, np.arange(3.5, 8.4, 0.5))


def test_a_map_is_drawn_once_a_scan_way_and_raster(monkeypatch):
    scan, drawn = street(LEVEL), []
    draw = stage._draw
    monkeypatch.setattr(stage, "_draw", lambda scan, T, raster: drawn.append(raster) or draw(scan, T, raster))
    other, level = Raster(0.25, 96), find_level(scan).T_level_scan
    assert wall_map(scan, level, RASTER) is wall_map(scan, level, RASTER)
    assert wall_map(scan, level, other) is not wall_map(scan, level, RASTER)
    wall_map(dataclasses.replace(scan, memo={}), level, other)
    known = find_level(scan, z_is_up=True).T_level_scan
    assert wall_map(scan, known, other).T_level_scan is known
    assert drawn == [RASTER, other, other, other]


def test_a_field_has_no_walls():
    drawn = map_of_scan(field(LEVEL))
    assert drawn.walls.shape == drawn.normals.shape == drawn.taken.shape == (0, 2)
    assert len(drawn.free) > 1000


# Rasters


def ring(reach_m: float, origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> PreparedScan:
    """Points at one distance from a sensor."""
    azimuth = np.linspace(0, 2 * np.pi, 200)
    around = np.column_stack((np.cos(azimuth), np.sin(azimuth), np.zeros(200)))
    return prepared(reach_m * around + origin, origin=origin)


@pytest.mark.parametrize("reach_m", [0.5, 5.0, 10.7, 10.9, 14.5, 17.0, 20.0, 35.0, 50.0, 71.0, 79.0, 85.0, 90.0, 500.0])
def test_the_finest_and_smallest_raster_with_room_for_both_is_chosen(reach_m):
    near, far = ring(0.4, (50.0, 2.0, 1.0)), ring(reach_m)
    chosen = choose_raster(near, far)
    assert chosen == choose_raster(far, near)
    *usual, largest = stage._SIZES
    rasters = [Raster(*edges) for edges in itertools.product(stage._CELLS_M, usual)]
    rasters.append(Raster(stage._CELLS_M[-1], largest))  # for what has room in no other
    assert chosen == next((raster for raster in rasters if raster.reach_m >= reach_m), rasters[-1])


def test_a_few_far_points_change_no_raster():
    points = np.concatenate((ring(9.0).points, [[300.0, 0, 0]]))
    assert choose_raster(prepared(points), ring(2.0)) == choose_raster(ring(9.0), ring(2.0))
