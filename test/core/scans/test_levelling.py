"""Up and the height above the ground, from the ground itself; and whether it can hardly be anything else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from level_cases import EYE_M, ROOM_EYE_M, field, plane, room, seen, simulated, street, tilt
from scan_cases import prepared, random_scan
from simulated_scans import Place

from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans import levelling
from svc_ros.core.scans.levelling import find_level
from svc_ros.core.se3 import apply, invert, rotation_angle_deg

LEVEL = np.eye(4)
SCENES = {"field": (field, EYE_M), "street": (street, EYE_M), "room": (room, ROOM_EYE_M)}


def level_error(scan: PreparedScan, T: np.ndarray, eye_m: float) -> tuple[float, float]:
    """Angle [deg] between up as found and as it is, and how far off [m] the height of the sensor is."""
    level = find_level(scan)
    assert level is not None
    up, true_up = level.T_level_scan[2, :3], T[:3, 2]
    height = apply(level.T_level_scan, scan.sensor_origin[None])[0]
    np.testing.assert_allclose(height[:2], 0.0, atol=1e-9)
    return float(np.degrees(np.arccos(np.clip(up @ true_up, -1.0, 1.0)))), abs(height[2] - eye_m)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (30.0, -12.0, 7.0)])
@pytest.mark.parametrize(("deg", "azimuth_deg"), [(0, 0), (3, 200), (12, 40), (20, -100), (30, 75)])
@pytest.mark.parametrize("scene", SCENES)
def test_up_and_the_height_are_found_however_the_sensor_stands(scene, deg, azimuth_deg, origin):
    make, eye_m = SCENES[scene]
    T = tilt(deg, azimuth_deg, origin)
    angle, height = level_error(make(T), T, eye_m)
    assert angle < 1.0
    assert height < 0.05


@pytest.mark.parametrize("deg", [0.0, 8.0, 30.0])
@pytest.mark.parametrize("sensor", ["OS0-64", "VLP-16"])
def test_up_is_found_by_real_beams_in_a_building(sensor, deg):
    scan = simulated(Place("indoor", sensor, 2, 20.0), "lidar_indoor", deg, 40.0)
    angle, height = level_error(scan, tilt(deg, 40.0), 1.2)
    assert angle < 2.0
    assert height < 0.1


def test_a_level_is_the_smallest_turn_so_that_a_level_scan_stays_as_it_is():
    scan = street(LEVEL)
    np.testing.assert_allclose(find_level(scan).T_level_scan[:3, :3], np.eye(3), atol=1e-12)
    tilted = street(tilt(20.0, 40.0))
    assert rotation_angle_deg(find_level(tilted).T_level_scan[:3, :3]) == pytest.approx(20.0)


@pytest.mark.parametrize("deg", [45.0, 60.0, 90.0, 135.0, 180.0])
def test_a_sensor_that_stands_too_steeply_finds_no_level(deg):
    assert find_level(field(tilt(deg))) is None
    if deg == 45.0:
        assert find_level(street(tilt(deg))) is None


def test_the_height_is_that_above_the_ground_nearby():
    """Not above an embankment that is farther away, and larger."""
    near, far = plane((0, 0, -EYE_M), (10, 0, 0), (0, 10, 0)), plane((0, 40, 0.5 - EYE_M), (30, 0, 0), (0, 15, 0))
    level = find_level(seen({(0, 0, 1): [near, far[::2]]}, LEVEL))
    assert level.T_level_scan[2, 3] == pytest.approx(EYE_M)


def test_without_ground_there_is_no_level():
    ceiling = plane((0, 0, 3.0), (20, 0, 0), (0, 20, 0))
    wall = plane((0, 5.0, 0), (20, 0, 0), (0, 0, 5.0))
    above = plane((0, 0, 1.0), (20, 0, 0), (0, 20, 0))  # faces up, but stands over the sensor
    for surfaces in ({(0, 0, -1): [ceiling]}, {(0, -1, 0): [wall]}, {(0, 0, 1): [above]}):
        assert find_level(seen(surfaces, LEVEL)) is None
    assert find_level(prepared(np.zeros((0, 3)), np.zeros((0, 3)))) is None
    assert find_level(random_scan(30, seed=1)) is None


def test_a_handful_of_ground_is_no_ground():
    patch, wall = plane((4, 0, -EYE_M), (1.5, 0, 0), (0, 1.5, 0)), plane((0, 9, 3), (40, 0, 0), (0, 0, 4))
    assert len(patch) == 49
    assert find_level(seen({(0, 0, 1): [patch]}, LEVEL)) is None
    assert find_level(seen({(0, 0, 1): [patch, patch]}, LEVEL)) is not None
    assert find_level(seen({(0, 0, 1): [patch, patch], (0, -1, 0): [wall] * 4}, LEVEL)) is None


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("deg", [0.0, 15.0])
def test_a_level_is_sure_where_the_sensor_stands_about_upright(scene, deg):
    assert find_level(SCENES[scene][0](tilt(deg))).sure


@pytest.mark.parametrize("scene", SCENES)
def test_a_level_is_not_sure_where_the_sensor_leans(scene):
    assert not find_level(SCENES[scene][0](tilt(27.0))).sure


@pytest.mark.parametrize("deg", [70.0, 90.0, -90.0, 110.0])
@pytest.mark.parametrize("make", [room, street])
def test_a_wall_that_is_taken_for_the_ground_is_not_sure(make, deg):
    """Of a scan turned on its side."""
    level = find_level(make(tilt(deg, 0.0)))
    assert level is None or not level.sure
    if make is room and abs(deg) == 90.0:
        assert level is not None


def test_a_level_is_not_sure_where_much_lies_below_the_ground_or_a_wall_is_larger():
    assert find_level(street(LEVEL, below_m=0.4)).sure
    assert not find_level(street(LEVEL, below_m=3.0)).sure
    assert not find_level(street(LEVEL, walls_m=40.0)).sure


def test_walls_that_face_one_way_are_counted_however_they_are_turned():
    normals = np.tile([[1.0, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]], (10, 1))
    normals[1::8] = tilt(5.0, 0.0)[[1, 2, 0]][:, [1, 2, 0]] @ (0, 1, 0)  # uneven
    for deg in np.arange(0.0, 360.0, 2.5):
        turned = normals @ tilt(deg, 0.0)[[1, 2, 0]][:, [1, 2, 0]].T
        assert levelling._largest_wall(turned) == pytest.approx(0.5)
    assert levelling._largest_wall(np.tile([0.0, 0, 1], (5, 1))) == 0.0


@pytest.mark.parametrize("make", [street, lambda T: random_scan(30, seed=1)])
def test_a_level_is_found_once_a_scan(monkeypatch, make):
    scan, found = make(LEVEL), []
    search = levelling._find_level
    monkeypatch.setattr(levelling, "_find_level", lambda scan: found.append(scan) or search(scan))
    assert find_level(scan) is find_level(scan)
    assert len(found) == 1
    find_level(dataclasses.replace(scan, memo={}))
    assert len(found) == 2


def test_the_ground_lies_at_zero_and_the_scan_is_only_moved():
    T = tilt(17.0, 120.0, (4.0, 5.0, 6.0))
    scan = street(T)
    level = find_level(scan).T_level_scan
    heights = apply(level, scan.points)[scan.normals @ T[:3, 2] > 0.9, 2]
    np.testing.assert_allclose(heights, 0.0, atol=1e-9)
    np.testing.assert_allclose(level @ invert(level), np.eye(4), atol=1e-12)


def test_where_z_is_known_to_be_up_it_is_and_surely():
    tilted = field(tilt(10.0))
    level = find_level(tilted, z_is_up=True)
    np.testing.assert_array_equal(level.T_level_scan[:3, :3], np.eye(3))
    assert level.sure
    assert rotation_angle_deg(find_level(tilted).T_level_scan[:3, :3]) > 9.0  # what is seen is kept apart


def test_the_lowest_surface_stands_for_ground_that_is_not_seen():
    wall = plane((5.0, 0.0, 0.75), (0.0, 8.0, 0.0), (0.0, 0.0, 3.5))  # from a metre below the sensor on
    scan = seen({(-1, 0, 0): [wall]}, tilt(0.0))
    assert find_level(scan) is None
    level = find_level(scan, z_is_up=True)
    lowest = apply(level.T_level_scan, scan.points)[:, 2].min()
    assert -0.3 < lowest <= 0.0
