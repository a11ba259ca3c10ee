"""Motion from scan to scan: only what is kept changes it, and a moving sensor's scans come out straight."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from mini_data import scan_room
from scipy.spatial.transform import Rotation
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.scan import Scan
from svc_ros.pipeline.motion import KissMotion, scale_motion

CONFIG = with_values(preset("lidar_indoor"), {"scan_matching.map_voxel_size_m": 0.3})
STEP_NS = 100_000_000
STEP = se3.make_pose(Rotation.from_euler("z", 4.0, degrees=True).as_matrix(), (0.15, 0.02, 0.0))


LIFT = se3.make_pose(np.eye(3), (0.0, 0.0, 1.2))  # the room's floor is at zero


def pose_at(step: float) -> np.ndarray:
    """A drive along a circle: the pose after so many steps."""
    return scale_motion(STEP, step)


def room_at(k: int) -> Scan:
    return Scan(scan_room(LIFT @ pose_at(k), seed=k), k * STEP_NS, "lidar")


def swept_room(k: int, first: float, last: float) -> tuple[Scan, np.ndarray]:
    """A scan whose points were measured between two offsets [steps] around its stamp; and as if at the stamp."""
    at_stamp = scan_room(LIFT @ pose_at(k), seed=k)
    steps = np.linspace(first, last, 60)
    which = np.random.default_rng(k).integers(0, 60, len(at_stamp))
    offsets, moves = steps[which], np.array([se3.invert(scale_motion(STEP, step)) for step in steps])[which]
    seen = np.einsum("nij,nj->ni", moves[:, :3, :3], at_stamp) + moves[:, :3, 3]
    return Scan(seen, k * STEP_NS, "lidar", point_times_s=offsets * 1e-9 * STEP_NS), at_stamp


@pytest.mark.parametrize("angle_deg", [0.0, 1e-7, 0.5, 40.0, 179.0])
def test_a_motion_in_parts_is_the_whole_motion(angle_deg: float) -> None:
    T = se3.make_pose(Rotation.from_rotvec(np.radians(angle_deg) * np.array([0.6, 0.0, 0.8])).as_matrix(), (3, -1, 2))
    half = scale_motion(T, 0.5)
    np.testing.assert_allclose(half @ half, T, atol=1e-9)
    np.testing.assert_allclose(scale_motion(T, 1.0), T, atol=1e-9)
    np.testing.assert_allclose(scale_motion(T, -1.0), se3.invert(T), atol=1e-9)
    np.testing.assert_allclose(scale_motion(T, 0.0), np.eye(4), atol=1e-12)


def test_half_of_a_quarter_turn_lies_on_the_circle() -> None:
    quarter = se3.make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1.0, 1.0, 0.0))
    np.testing.assert_allclose(scale_motion(quarter, 0.5)[:3, 3], (np.sqrt(0.5), 1 - np.sqrt(0.5), 0.0), atol=1e-12)


def test_a_kept_drive_is_followed() -> None:
    motion = KissMotion(preset("lidar_outdoor"))
    drive = [scan_at(Place("street", "VLP-16", 1, 10.0 + 1.0 * k)) for k in range(5)]
    for k, (scan, _) in enumerate(drive):
        found = motion.estimate(dataclasses.replace(scan, stamp_ns=k * STEP_NS))
        motion.keep(found, found.T_odom_scan)
    angle, distance = se3.pose_error(found.T_odom_scan, se3.invert(drive[0][1]) @ drive[-1][1])
    assert angle < 1.0
    assert distance < 0.3


def test_the_first_scan_stands_at_the_origin() -> None:
    np.testing.assert_allclose(KissMotion(CONFIG).estimate(room_at(3)).T_odom_scan, np.eye(4), atol=1e-12)


def test_what_is_not_kept_changes_nothing() -> None:
    plain, disturbed = KissMotion(CONFIG), KissMotion(CONFIG)
    for k in range(3):
        for motion in (plain, disturbed):
            motion.keep(motion.estimate(room_at(k)), pose_at(k))
    disturbed.estimate(Scan(scan_room(LIFT, seed=1) * 1.5, 3 * STEP_NS, "lidar"))
    np.testing.assert_array_equal(plain.estimate(room_at(4)).T_odom_scan, disturbed.estimate(room_at(4)).T_odom_scan)


def test_the_prediction_spans_the_time_between_stamps() -> None:
    motion = KissMotion(CONFIG)
    for k in (0, 1):
        motion.keep(motion.estimate(room_at(k)), pose_at(k))
    np.testing.assert_allclose(motion.estimate(room_at(3)).T_start, pose_at(3), atol=1e-9)
    np.testing.assert_allclose(motion.estimate(room_at(30)).T_start, pose_at(1), atol=1e-9)  # too long ago to go on


def test_another_start_is_searched_with_the_same_points() -> None:
    motion = KissMotion(CONFIG)
    motion.keep(motion.estimate(room_at(0)), np.eye(4))
    turn = se3.make_pose(Rotation.from_euler("z", 60, degrees=True).as_matrix(), (0, 0, 0))
    scan = Scan(scan_room(LIFT @ turn, seed=5), STEP_NS, "lidar")
    first = motion.estimate(scan)
    again = motion.estimate_again(first, turn)
    assert se3.pose_error(first.T_odom_scan, turn)[0] > 5.0
    assert se3.pose_error(again.T_odom_scan, turn)[0] < 0.5
    assert again.icp_points is first.icp_points


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.9), (-0.9, 0.0), (-0.4, 0.5)])
def test_points_are_moved_to_where_the_sensor_stood_at_the_stamp(first: float, last: float) -> None:
    motion = KissMotion(CONFIG)
    for k in (0, 1):
        motion.keep(motion.estimate(room_at(k)), pose_at(k))
    swept, straight = swept_room(2, first, last)
    found = motion.estimate(swept)
    assert np.abs(swept.points - straight).max() > 0.1
    np.testing.assert_allclose(found.scan.points, straight, atol=1e-6)
    assert found.scan.point_times_s is None
    assert found.scan.stamp_ns == swept.stamp_ns


@pytest.mark.parametrize("times", [None, 0.05])
def test_a_scan_without_different_times_stays_as_it_is(times: float | None) -> None:
    motion = KissMotion(CONFIG)
    for k in (0, 1):
        motion.keep(motion.estimate(room_at(k)), pose_at(k))
    points = scan_room(LIFT @ pose_at(2), seed=2)
    scan = Scan(points, 2 * STEP_NS, "lidar", point_times_s=None if times is None else np.full(len(points), times))
    np.testing.assert_array_equal(motion.estimate(scan).scan.points, points)


def test_environment_variables_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def drive() -> np.ndarray:
        motion = KissMotion(CONFIG)
        for k in range(3):
            found = motion.estimate(room_at(k))
            motion.keep(found, found.T_odom_scan)
        return found.T_odom_scan

    expected = drive()
    monkeypatch.setenv("kiss_icp_registration", '{"max_num_iterations": 1}')
    monkeypatch.setenv("kiss_icp_mapping", '{"voxel_size": 5.0}')
    np.testing.assert_array_equal(drive(), expected)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    with pytest.raises(MissingDependencyError, match="pip install 'kiss-icp"):
        KissMotion(CONFIG)
