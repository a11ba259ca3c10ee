"""A pose in a map is judged by the keyframes around it, each from its own origin; what they say is combined."""

from __future__ import annotations

import numpy as np
import pytest
from map_in_memory import MapInMemory
from mini_data import scan_room, sensor_pose

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Scan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.neighbours import judge_among_neighbours

CONFIG = preset("lidar_indoor")
STANDS = [sensor_pose(x, 0.0, 40.0 * k) for k, x in enumerate((-4.0, -1.0, 2.0, 5.0))]
HERE = sensor_pose(-0.5, -1.0, 100.0)


def keyframe(T: np.ndarray) -> Keyframe:
    return Keyframe(prepare(Scan(scan_room(T, seed=9)), CONFIG), None, CONFIG)


@pytest.fixture
def room() -> MapInMemory:
    return MapInMemory([Scan(scan_room(T, seed=k), k) for k, T in enumerate(STANDS)], STANDS, CONFIG)


def test_a_right_pose_is_accepted_refined_and_no_surer_than_the_surest_neighbour(room: MapInMemory) -> None:
    moved = HERE.copy()
    moved[:3, 3] += (0.2, -0.1, 0.0)
    placed = judge_among_neighbours(keyframe(HERE), moved, room, CONFIG)
    assert placed.result.accepted
    assert placed.target is not None
    assert se3.pose_error(placed.T_map_scan, HERE)[1] < 0.05
    alone = [
        verify(keyframe(HERE).scan, k.scan, se3.invert(T) @ HERE, CONFIG).probability
        for k, T in zip(room.keyframes, STANDS, strict=True)
    ]
    assert placed.probability <= max(p for p in alone if p is not None) + 1e-3


def test_one_keyframe_that_sees_through_a_pose_is_enough_to_deny_it(room: MapInMemory) -> None:
    """The nearest one accepts it; the next one has seen a wider room, of the same height."""
    assert judge_among_neighbours(keyframe(HERE), HERE, room, CONFIG).result.accepted
    wider = Scan(scan_room(STANDS[2], seed=2) * (1.5, 1.5, 1.0), 2)
    room.keyframes[2] = Keyframe(prepare(wider, CONFIG), STANDS[2], CONFIG)
    placed = judge_among_neighbours(keyframe(HERE), HERE, room, CONFIG)
    assert (placed.result.verdict, placed.is_denied, placed.target) == (Verdict.REJECTED, True, 2)
    nearest_only = with_values(CONFIG, {"localization.max_neighbours": 1})
    assert judge_among_neighbours(keyframe(HERE), HERE, room, nearest_only).result.accepted


def test_a_wrong_pose_is_rejected(room: MapInMemory) -> None:
    for wrong in (sensor_pose(1.5, -1.0, 100.0), sensor_pose(-0.5, -1.0, 120.0), sensor_pose(-0.5, -1.0, 280.0)):
        assert judge_among_neighbours(keyframe(HERE), wrong, room, CONFIG).result.verdict is Verdict.REJECTED


def test_far_from_all_keyframes_nothing_is_known(room: MapInMemory) -> None:
    placed = judge_among_neighbours(keyframe(HERE), sensor_pose(500.0, 0.0, 0.0), room, CONFIG)
    assert (placed.result.verdict, placed.target) == (Verdict.UNDECIDED, None)
    assert placed.result.reason is Reason.INSUFFICIENT_EVIDENCE
    assert "60 m" in placed.result.detail
