"""Scans without odometry go on from the last one by registration; frames that nothing joins are told apart."""

from __future__ import annotations

import numpy as np
from mini_data import scan_room, sensor_pose

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Scan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.own_steps import OwnSteps

CONFIG = preset("lidar_indoor")
WAY = [sensor_pose(x, 0.0, 10.0 * k) for k, x in enumerate((-1.0, -0.5, 0.0, 0.5))]


def keyframe(k: int) -> Keyframe:
    return Keyframe(prepare(Scan(scan_room(WAY[k], seed=k), k), CONFIG), None, CONFIG)


def somewhere_else() -> Keyframe:
    """A plane: no registration to the room is accepted."""
    plane = np.random.default_rng(0).uniform(-20.0, 20.0, (4000, 3)) * (1.0, 1.0, 0.0) - (0.0, 0.0, 1.0)
    return Keyframe(prepare(Scan(plane, 9), CONFIG), None, CONFIG)


def test_what_odometry_says_is_taken_as_it_is() -> None:
    steps = OwnSteps(CONFIG)
    for k, T in enumerate(WAY[:2]):
        pose, is_joined = steps.follow(keyframe(k), T)
        assert is_joined
        np.testing.assert_array_equal(pose, T)


def test_where_it_says_nothing_the_scan_is_registered_to_the_last_one() -> None:
    steps = OwnSteps(CONFIG)
    steps.follow(keyframe(0), WAY[0])
    for k in (1, 2):
        pose, is_joined = steps.follow(keyframe(k), None)
        assert is_joined
        assert se3.pose_error(pose, WAY[k])[1] < 0.05
    assert steps.follow(keyframe(3), WAY[3])[1]  # the same frame all the way


def test_a_scan_that_nothing_joins_begins_a_frame_of_its_own_and_odometry_ends_it() -> None:
    steps = OwnSteps(CONFIG)
    steps.follow(keyframe(0), WAY[0])
    pose, is_joined = steps.follow(somewhere_else(), None)
    assert not is_joined
    np.testing.assert_array_equal(pose, np.eye(4))
    assert not steps.follow(keyframe(1), WAY[1])[1]
    assert steps.follow(keyframe(2), WAY[2])[1]


def test_a_beginning_without_odometry_is_not_joined_to_odometry_that_comes_later() -> None:
    steps = OwnSteps(CONFIG)
    assert steps.follow(keyframe(0), None)[1]
    assert not steps.follow(keyframe(1), WAY[1])[1]
