"""Every turn and every shift on the ground: scores equal to sums taken one by one, and the right pose is found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_wall_maps as reference
from assertions import assert_same_bits
from level_cases import field, room, street, tilt, tilted_pair
from scan_cases import T_ROOM, real_pair
from simulated_scans import Place

from svc_ros.core import parallel, se3
from svc_ros.core.registration import prepare
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.levelling import find_level
from svc_ros.core.scans.wall_map import Raster, WallMap, choose_raster, wall_map
from svc_ros.core.search import levelled_poses as stage
from svc_ros.core.search.levelled_poses import find_levelled_poses, score_all

RASTER = Raster(0.5, 16)
HALF = RASTER.size // 2
LIMIT = 24


def levelled_poses(source: PreparedScan, target: PreparedScan, limit: int) -> np.ndarray:
    return find_levelled_poses(source, target, [find_level(source), find_level(target)], limit)


def map_of(num_walls: int, num_taken: int, num_free: int, seed: int, lattice: bool = False) -> WallMap:
    """Walls and cells anywhere on a small map; on a lattice all lie at middles of cells."""
    rng = np.random.default_rng(seed)
    walls, taken, free = (rng.uniform(-HALF, HALF, (num, 2)) for num in (num_walls, num_taken, num_free))
    if lattice:
        walls, taken, free = (np.floor(places) for places in (walls, taken, free))
    facing = rng.uniform(0, 2 * np.pi, num_walls)
    normals = np.column_stack((np.cos(facing), np.sin(facing)))
    return WallMap(np.eye(4), *(np.asarray(a) for a in (walls * 0.5, normals, taken * 0.5, free * 0.5)))


def images_of(drawn: WallMap, turn: int) -> np.ndarray:
    angle = 2.0 * np.pi * turn / stage._TURNS
    return reference.images(
        drawn.walls, drawn.normals, drawn.taken, drawn.free, (np.cos(angle), np.sin(angle)), RASTER
    )  # fmt: skip


def scores_of(source: WallMap, target: WallMap, turn: int) -> np.ndarray:
    """(S, S), the source drawn anew for that turn."""
    return reference.shift_scores(
        images_of(target, 0), images_of(source, turn), stage._CONTRADICTION, stage._BLUR_CELLS
    )  # fmt: skip


MAPS = {
    "random": (map_of(60, 20, 50, 1), map_of(80, 30, 60, 2)),
    "crowded": (map_of(500, 200, 200, 3), map_of(400, 250, 150, 4)),
    "same": (map_of(40, 20, 30, 5), map_of(40, 20, 30, 5)),
    "no_walls": (map_of(0, 0, 40, 6), map_of(50, 20, 0, 7)),
    "one_wall": (map_of(1, 1, 0, 8), map_of(1, 1, 1, 9)),
    "nothing": (map_of(0, 0, 0, 10), map_of(30, 10, 20, 11)),
}


@pytest.mark.parametrize("case", MAPS)
def test_scores_are_sums_over_cells_for_every_turn_and_shift(case):
    """Those of turns beyond a quarter of a circle too, which nobody draws. Peaks of about the same height may swap."""
    source, target = MAPS[case]
    found = score_all(source, target, RASTER)
    assert found.shape == (stage._TURNS * stage._PEAKS, 4)
    assert sorted(set(found[:, 1])) == list(range(stage._TURNS))
    for turn in [*range(0, stage._TURNS, 17), 30, 60, 90]:
        expected, rows = scores_of(source, target, turn), found[found[:, 1] == turn]
        rows = rows[np.isfinite(rows[:, 0])]
        shift = rows[:, 2:].astype(int)
        assert ((shift >= -HALF) & (shift < HALF)).all()
        tolerance = 1e-5 * max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(rows[:, 0], expected[tuple(shift.T)], rtol=0, atol=tolerance)
        assert rows[0, 0] == pytest.approx(expected.max(), abs=tolerance)
        if case not in ("nothing", "one_wall"):  # flat, or all but flat: rounding makes the peaks
            best = [value for value, _, _ in reference.peaks(expected, stage._PEAKS)]
            np.testing.assert_allclose(rows[:, 0], best, rtol=0, atol=tolerance)


@pytest.mark.parametrize("turn", [0, 7, 20])
@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_map_turned_by_a_quarter_is_drawn_like_the_turned_image(turn, quarter):
    """Exactly, as long as nothing lies on a border: cells are named by their middles, and the turn keeps those."""
    source = map_of(200, 60, 90, 12)
    drawn, turned = (stage._draw(source, k, RASTER) for k in (turn, turn + quarter * stage._TURNS // 4))
    walls, seen = (reference.turn_by_quarters(image, quarter) for image in drawn)
    np.testing.assert_allclose(turned[0], walls * 1j**quarter, atol=1e-5)
    np.testing.assert_array_equal(turned[1], seen)


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_middles_of_cells_turn_exactly_by_quarters(quarter):
    lattice = map_of(200, 60, 90, 13, lattice=True)
    drawn, turned = (stage._draw(lattice, quarter * k * stage._TURNS // 4, RASTER) for k in (0, 1))
    np.testing.assert_array_equal(turned[1], reference.turn_by_quarters(drawn[1], quarter))
    np.testing.assert_allclose(turned[0], reference.turn_by_quarters(drawn[0], quarter) * 1j**quarter, atol=1e-5)


@pytest.mark.parametrize("make", [street, room])
def test_maps_of_scans_turn_by_quarters_but_for_what_lies_on_borders(make):
    scan = make(tilt(5.0))
    raster = choose_raster(scan, scan)
    drawn = wall_map(scan, find_level(scan).T_level_scan, raster)
    for turn, share in ((0, 0.0), (11, 0.0), (10, 0.01)):  # the last puts the half of an odd number on borders
        images, turned = (stage._draw(drawn, k, raster) for k in (turn, turn + stage._TURNS // 4))
        assert np.count_nonzero(turned[1] == 1.0) > 50
        assert np.mean(turned[1] != reference.turn_by_quarters(images[1], 1)) <= share


def test_a_map_agrees_best_with_itself_turned_and_shifted_back():
    source = map_of(60, 20, 60, 14, lattice=True)
    for turn, shift in ((0, (0, 0)), (30, (3, -5)), (90, (-8, 7))):
        angle = 2.0 * np.pi * turn / stage._TURNS
        R = np.round([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        places = (0.5 * (np.asarray(shift) + 2.0 * at @ R.T) for at in (source.walls, source.taken, source.free))
        walls, taken, free = places
        rows = score_all(source, WallMap(np.eye(4), walls, source.normals @ R.T, taken, free), RASTER)
        assert rows[rows[:, 0].argmax(), 1:].tolist() == [turn, *shift]


# Poses


def rank_of(poses: np.ndarray, T: np.ndarray, deg: float = 3.0, m: float = 1.0) -> int:
    """Place of the first pose that is so near, or a large number."""
    errors = [se3.pose_error(pose, T) for pose in poses]
    return next((k for k, (angle, distance) in enumerate(errors) if angle < deg and distance < m), 1000)


PLACES = [("street", "HDL-64E", "lidar_outdoor", 12.0), ("street", "VLP-16", "lidar_outdoor", 8.0),
          ("indoor", "OS0-64", "lidar_indoor", 4.0)]  # fmt: skip


@pytest.mark.parametrize(("scene", "sensor", "preset_name", "way_m"), PLACES)
def test_the_right_pose_is_among_the_first_whichever_way_the_sensors_lean(scene, sensor, preset_name, way_m):
    places = Place(scene, sensor, 2, 20.0 + way_m, 140.0), Place(scene, sensor, 2, 20.0)
    source, target, T = tilted_pair(places, preset_name)
    assert rank_of(levelled_poses(source, target, LIMIT), T) < 3
    assert rank_of(levelled_poses(target, source, LIMIT), se3.invert(T)) < 3


def test_the_sensor_may_stand_anywhere_in_its_scan():
    """The room, a step and a turn apart, both scans in frames of their own."""
    A, B = tilt(4.0, 70.0, (30.0, -5.0, 2.0)), tilt(6.0, -50.0, (-8.0, 40.0, 0.0))
    poses = levelled_poses(room(A, 1), room(B, 0), LIMIT)
    assert rank_of(poses, B @ T_ROOM @ se3.invert(A)) < 3


@pytest.mark.parametrize("index", [57, 65])
def test_real_scans_that_hardly_overlap_are_found(shared_data, index):
    source, target, T, config = real_pair(shared_data, "os0_64_walk", index)
    poses = levelled_poses(prepare(source, config), prepare(target, config), LIMIT)
    assert rank_of(poses, T) < 8


@pytest.fixture(scope="module")
def rooms() -> tuple[PreparedScan, PreparedScan]:
    return room(tilt(2.0), 1), room(tilt(3.0, 10.0), 0)


def test_poses_are_distinct_and_no_more_than_asked_for(rooms):
    all_of_them = levelled_poses(*rooms, 60)
    assert len(all_of_them) == 60
    for limit in (0, 1, 7):
        assert_same_bits(levelled_poses(*rooms, limit), all_of_them[:limit])
    raster, levels = choose_raster(*rooms), [find_level(scan).T_level_scan for scan in rooms]
    flat = levels[1] @ all_of_them @ se3.invert(levels[0])
    np.testing.assert_allclose(flat[:, 2], [[0, 0, 1, 0]] * 60, atol=1e-9)
    yaw = np.degrees(np.arctan2(flat[:, 1, 0], flat[:, 0, 0]))
    apart_deg = np.abs((yaw[:, None] - yaw + 180.0) % 360.0 - 180.0)
    apart = np.abs(flat[:, None, :2, 3] - flat[:, :2, 3])
    apart = np.minimum(apart, raster.size * raster.cell_m - apart).max(-1) / raster.cell_m
    near = (apart_deg < 3.0 * stage._NEAR_TURNS + 0.1) & (apart < stage._NEAR_CELLS + 0.1)
    np.testing.assert_array_equal(near, np.eye(60, dtype=bool))


def test_the_best_of_peaks_that_are_near_stays():
    """Around the circle and around the map; of equal ones the first."""
    size, turns = RASTER.size, stage._TURNS
    peaks = np.array(
        [[5.0, 0, 0, 0], [9.0, turns - 1, 1, size - 1], [9.0, 40, 3, 3], [9.0, 40, 4, 4], [8.0, 43, 3, 3],
         [7.0, 40, 6, 3], [-np.inf, 80, 3, 3], [6.0, 42, 5, 5]]
    )  # fmt: skip
    assert stage._distinct(peaks, 99, RASTER).tolist() == peaks[[1, 2, 4, 5]].tolist()
    assert stage._distinct(peaks, 2, RASTER).tolist() == peaks[[1, 2]].tolist()
    assert stage._distinct(peaks[:0], 5, RASTER).shape == stage._distinct(peaks, 0, RASTER).shape == (0, 4)
    assert stage._distinct(peaks[6:7], 5, RASTER).shape == (0, 4)


def test_fields_without_walls_are_put_on_each_other_anyhow():
    """Nothing tells how, but all poses are level and one is there."""
    poses = levelled_poses(field(tilt(3.0)), field(tilt(0.0)), LIMIT)
    assert 1 <= len(poses) <= LIMIT
    np.testing.assert_allclose(poses[:, :3, :3] @ tilt(3.0)[:3, 2], [[0, 0, 1]] * len(poses), atol=1e-9)


@pytest.fixture
def _all_threads_afterwards():
    limits = list(parallel._limits)
    yield
    parallel._limits[:] = limits


@pytest.mark.usefixtures("_all_threads_afterwards")
def test_runs_and_thread_counts_give_the_same_bits(rooms):
    def fresh() -> np.ndarray:
        return levelled_poses(*(dataclasses.replace(scan, memo={}) for scan in rooms), LIMIT)

    first, again = fresh(), fresh()
    parallel.limit_threads(1)
    assert_same_bits(again, first)
    assert_same_bits(fresh(), first)
