"""The look of a place: blind to the sensor's turn, which it tells; alike for near places, unlike for others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from mini_data import scan_room, sensor_pose
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.pipeline.place import compare_places, look_at_place

CONFIG = preset("lidar_indoor")


def prepared(x: float, y: float, yaw_deg: float, seed: int = 0) -> PreparedScan:
    return prepare(Scan(scan_room(sensor_pose(x, y, yaw_deg), seed)), CONFIG)


def yaw_deg(T: np.ndarray) -> float:
    return float(Rotation.from_matrix(T[:3, :3]).as_euler("zyx", degrees=True)[0])


def test_a_place_is_most_like_itself() -> None:
    look = look_at_place(prepared(0, 0, 0))
    likeness, T = compare_places(look, look)
    assert likeness == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(T, np.eye(4), atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 36.0, 90.0, 171.0, -120.0])
def test_the_turn_between_two_looks_is_found(turn: float) -> None:
    source, target = look_at_place(prepared(0.2, 0.1, turn, seed=1)), look_at_place(prepared(0, 0, 0))
    likeness, T = compare_places(source, target)
    assert likeness > 0.85
    assert abs((yaw_deg(T) - turn + 180.0) % 360.0 - 180.0) <= 6.0


def test_likeness_does_not_depend_on_the_turn_nor_on_the_order() -> None:
    looks = [look_at_place(prepared(0.5, 0.3, turn)) for turn in (0.0, 100.0)]
    other = look_at_place(prepared(-3.0, 1.0, 10.0))
    first, second = (compare_places(look, other)[0] for look in looks)
    assert first == pytest.approx(second, abs=0.05)
    assert compare_places(other, looks[0])[0] == pytest.approx(first, abs=1e-9)


def test_near_places_look_more_alike_than_far_ones() -> None:
    here = look_at_place(prepared(0, 0, 0))
    likeness = [compare_places(look_at_place(prepared(x, 0, 50.0)), here)[0] for x in (0.2, 1.0, 5.5)]
    assert likeness == sorted(likeness, reverse=True)


def test_both_sensors_end_in_one_spot_wherever_they_stand_in_their_frames() -> None:
    scans = [prepared(0, 0, 0), prepared(0, 0, 45.0)]
    offsets = [np.array([1.0, 2.0, 3.0]), np.array([-4.0, 0.5, 1.0])]
    moved = [
        dataclasses.replace(s, points=s.points + o, sensor_origin=s.sensor_origin + o, memo={})
        for s, o in zip(scans, offsets, strict=True)
    ]
    source, target = (look_at_place(scan) for scan in moved)
    likeness, T = compare_places(source, target)
    assert likeness == pytest.approx(compare_places(*(look_at_place(s) for s in scans))[0], abs=1e-6)
    np.testing.assert_allclose(se3.apply(T, offsets[0][None])[0], offsets[1], atol=1e-9)
