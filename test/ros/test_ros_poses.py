"""Poses by stamp, and odometry as it is told: no node, no middleware."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from yardstick import PATIENCE_S, Stopwatch

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import invert, make_pose
from svc_ros.pipeline.stream import StreamDecision
from svc_ros.ros.streams.odometry_track import OdometryTrack
from svc_ros.ros.topics.poses import PoseBuffer

SECOND = 1_000_000_000
SKEW = SECOND // 20
BASE = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (0.5, 0.0, 1.0))  # T_base_cloud


def at_x(x: float) -> np.ndarray:
    return make_pose(np.eye(3), (x, 0.0, 0.0))


@pytest.fixture
def buffer():
    """Poses at 10, 11 and 12 s, ten times as many metres along x."""
    buffer = PoseBuffer(capacity=10)
    for second in (10, 12, 11):  # one of them late
        buffer.add(second * SECOND, at_x(10.0 * second))
    return buffer


def test_the_pose_between_two_stamps_is_interpolated(buffer):
    np.testing.assert_allclose(buffer.at(10 * SECOND + SECOND // 4, SKEW, 0.0), at_x(102.5), atol=1e-9)


def test_a_little_outside_the_span_the_last_pose_counts_and_farther_out_none(buffer):
    np.testing.assert_array_equal(buffer.at(12 * SECOND + SKEW, SKEW, 0.0), at_x(120.0))
    with pytest.raises(TransformUnavailableError, match=r"at 13\.000000000 s, found 10\.000000000 s to 12\.0"):
        buffer.at(13 * SECOND, SKEW, 0.0)
    with pytest.raises(TransformUnavailableError, match="none so far"):
        PoseBuffer(3).at(SECOND, SKEW, 0.0)


def test_the_pose_behind_a_stamp_is_waited_for(buffer):
    timer = threading.Timer(0.1, buffer.add, (14 * SECOND, at_x(140.0)))
    timer.start()
    np.testing.assert_allclose(buffer.at(13 * SECOND, SKEW, PATIENCE_S), at_x(130.0), atol=1e-9)
    timer.join()


def test_waiting_ends_when_the_time_is_over(buffer):
    with Stopwatch() as watch, pytest.raises(TransformUnavailableError):
        buffer.at(13 * SECOND, SKEW, 0.1)
    assert watch.elapsed_s >= 0.1
    assert watch.own_s < 2.0, watch


def test_the_nearest_pose_is_found_if_it_is_near_enough(buffer):
    np.testing.assert_array_equal(buffer.nearest(11 * SECOND - SKEW, SKEW), at_x(110.0))
    assert buffer.nearest(11 * SECOND - SKEW - 1, SKEW) is None
    assert PoseBuffer(1).nearest(0, SKEW) is None


def test_a_jump_back_in_time_forgets_what_was_before(buffer):
    buffer.add(5 * SECOND, at_x(50.0))
    assert buffer.nearest(12 * SECOND, SKEW) is None
    np.testing.assert_array_equal(buffer.nearest(5 * SECOND, SKEW), at_x(50.0))


def test_the_oldest_poses_leave_and_a_stamp_that_comes_again_counts_anew():
    buffer = PoseBuffer(capacity=2)
    for stamp, x in ((1, 1.0), (2, 2.0), (3, 3.0), (3, 4.0)):
        buffer.add(stamp, at_x(x))
    assert buffer.nearest(1, 0) is None
    np.testing.assert_array_equal(buffer.nearest(3, 0), at_x(4.0))
    np.testing.assert_array_equal(buffer.nearest(2, 0), at_x(2.0))


VARIANCES = np.diag([0.01, 0.01, 0.01, 1e-4, 1e-4, 1e-4])


def accepted(pose: np.ndarray, second: float, target: np.ndarray, target_second: float, origin: str = "motion"):
    """A scan at `pose`, judged against one at `target`."""
    T = invert(target) @ pose
    result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", T, T, VARIANCES)
    stamps = round(second * SECOND), round(target_second * SECOND)
    return StreamDecision(result, *stamps, "lidar", "lidar", pose, origin, None, target)


def test_uncertainty_grows_along_the_keyframes_and_not_with_the_scans():
    track = OdometryTrack()
    origin, first, second = np.eye(4), at_x(1.0), at_x(2.0)
    track.add(accepted(origin, 0.0, origin, 0.0, "start"), np.eye(4))
    a = track.add(accepted(first, 1.0, origin, 0.0), np.eye(4))
    b = track.add(accepted(second, 2.0, origin, 0.0), np.eye(4))
    c = track.add(accepted(at_x(3.0), 3.0, second, 2.0), np.eye(4))
    np.testing.assert_allclose(a.covariance, b.covariance)
    assert np.trace(c.covariance) > np.trace(b.covariance) + 0.9 * np.trace(VARIANCES)


def test_velocity_is_that_of_the_last_two_poses_in_the_sensors_own_frame():
    track = OdometryTrack()
    turn = make_pose(Rotation.from_euler("z", 0.2).as_matrix(), (0.0, 0.0, 0.0))
    sideways = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (3.0, 1.0, 0.0))
    told = track.add(accepted(sideways, 0.0, sideways, 0.0, "start"), np.eye(4))
    assert told.velocity is None
    moved = sideways @ make_pose(np.eye(3), (0.4, 0.0, 0.0))
    told = track.add(accepted(moved, 0.1, sideways, 0.0), np.eye(4))
    np.testing.assert_allclose(told.velocity, [4.0, 0, 0, 0, 0, 0], atol=1e-6)
    told = track.add(accepted(moved @ turn, 0.2, sideways, 0.0), np.eye(4))
    np.testing.assert_allclose(told.velocity, [0, 0, 0, 0, 0, 2.0], atol=1e-4)
    assert (np.linalg.eigvalsh(told.velocity_covariance) > 0.0).all()


def test_the_base_is_told_where_it_stands_and_began_at_the_origin():
    track = OdometryTrack()
    start = track.add(accepted(np.eye(4), 0.0, np.eye(4), 0.0, "start"), BASE)
    np.testing.assert_allclose(start.T_odom_base, np.eye(4), atol=1e-12)
    base_moved = at_x(1.5)  # forwards, as the robot sees it
    sensor_pose = invert(BASE) @ base_moved @ BASE
    told = track.add(accepted(sensor_pose, 0.5, np.eye(4), 0.0), BASE)
    np.testing.assert_allclose(told.T_odom_base, base_moved, atol=1e-9)
    np.testing.assert_allclose(told.velocity, [3.0, 0, 0, 0, 0, 0], atol=1e-6)


def test_what_was_not_accepted_is_not_told():
    rejected = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, "svc", None, np.eye(4))
    decision = StreamDecision(rejected, 1, 0, "lidar", "lidar", None, "motion", None, np.eye(4))
    assert OdometryTrack().add(decision, np.eye(4)) is None


def test_a_method_without_covariance_is_told_as_uncertain():
    result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, "sc2", np.eye(4), np.eye(4))
    decision = StreamDecision(result, 0, 0, "lidar", "lidar", np.eye(4), "start", None, np.eye(4))
    assert np.diag(OdometryTrack().add(decision, np.eye(4)).covariance).min() > 0.01
