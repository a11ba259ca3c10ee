"""When others are told where they are, and what is kept of what they tell; without a node."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Scan
from svc_ros.core.se3 import make_pose
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision, MapPlace
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.initial_pose import InitialPoseGuard
from svc_ros.ros.topics.sources import Sources
from svc_ros.ros.topics.told_poses import StampedPose, ToldPoses

KNOWN = MapPlace(np.eye(4), np.eye(6), np.eye(4))
UNSURE, LOST = MapPlace(T_map_odom=np.eye(4)), MapPlace()
RIGHT, WRONG, OPEN = Verdict.ACCEPTED, Verdict.REJECTED, Verdict.UNDECIDED
S = 1_000_000_000


def decision(verdict: Verdict, origin: str, stamp_s: float, place: MapPlace | None = None) -> Decision:
    T, label = np.eye(4) if verdict is RIGHT else None, CloudLabel(round(stamp_s * S), "lidar")
    return Decision(RegistrationResult(verdict, Reason.OK, "svc", T, T), label, label, origin=origin, place=place)


class Scans:
    """Feeds a guard with two scans a second; `told` are the numbers of the scans whose place was told."""

    def __init__(self) -> None:
        self.guard, self.num, self.told = InitialPoseGuard(), 0, []

    def see(self, place: MapPlace, others: Verdict | None = None, times: int = 1) -> None:
        for _ in range(times):
            now_s = 100.0 + 0.5 * self.num
            if others is not None:
                assert not self.guard.allows(decision(others, "told", now_s))
            if self.guard.allows(decision(RIGHT if place is KNOWN else OPEN, "motion", now_s, place)):
                self.told.append(self.num)
            self.num += 1


def test_after_five_silent_seconds_a_sure_scan_is_told_and_no_other():
    scans = Scans()
    scans.see(LOST)
    scans.see(KNOWN, times=40)
    assert scans.told == [10]


def test_who_was_unsure_has_to_be_sure_three_times_in_a_row():
    scans = Scans()
    scans.see(KNOWN, times=9)
    scans.see(UNSURE)
    scans.see(KNOWN, times=9)
    assert scans.told == [12]


def test_each_loss_is_told_of_once():
    scans = Scans()
    scans.see(KNOWN, times=20)
    scans.see(LOST)
    scans.see(KNOWN, times=20)
    assert scans.told == [10, 23]


def test_nothing_is_told_to_who_is_right_or_may_be():
    scans = Scans()
    scans.see(KNOWN, RIGHT, 20)
    scans.see(KNOWN, OPEN, 20)
    scans.see(KNOWN, WRONG, 2)
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, WRONG, 2)
    assert scans.told == []


def test_nor_to_who_is_right_and_slow():
    scans = Scans()
    for _ in range(10):
        scans.see(KNOWN, RIGHT)
        scans.see(KNOWN, times=8)
    assert scans.told == []


def test_who_was_told_and_stays_wrong_is_not_told_again_before_he_was_right():
    scans = Scans()
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, WRONG, 20)
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, WRONG, 20)
    assert scans.told == [3, 24]


def test_who_falls_silent_is_told_once():
    scans = Scans()
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, times=40)
    assert scans.told == [10]


def test_a_wrong_pose_is_left_alone_by_who_is_not_sure_himself():
    scans = Scans()
    for place in (UNSURE, LOST):
        scans.see(place, WRONG, 20)
    scans.see(KNOWN, WRONG, 2)
    assert scans.told == []


def test_a_reset_begins_anew():
    scans = Scans()
    scans.see(KNOWN, times=12)
    scans.guard.forget()
    scans.see(KNOWN, times=12)
    assert scans.told == [10, 22]


def told(stamp_s: float) -> StampedPose:
    return StampedPose(round(stamp_s * S), "map", np.eye(4))


def test_of_told_poses_the_last_one_up_to_a_stamp_is_taken_once():
    poses = ToldPoses()
    assert poses.take(S) is None
    first, second, later = told(1.0), told(2.0), told(9.0)
    for pose in (first, second, later):
        poses.add(pose)
    assert poses.take(2 * S) is second
    assert poses.take(2 * S) is None
    now = told(0.0)
    poses.add(now)
    assert poses.take(3 * S) is now
    assert poses.take(9 * S) is later
    poses.add(told(9.5))
    poses.add(again := told(4.0))  # a bag that starts again
    assert poses.take(20 * S) is again


def at_x(x: float) -> np.ndarray:
    return make_pose(np.eye(3), (x, 0.0, 0.0))


class Parts:
    """Frames as a static tree of places along x, and what was told."""

    def __init__(self) -> None:
        self.frames, self.inputs = self, SimpleNamespace(told=ToldPoses())

    def pose(self, target: str, source: str, *_when: object) -> np.ndarray:
        stands = {"map": 0.0, "grid": 100.0, "base_link": 0.0, "lidar": 0.25}
        if source not in stands:
            raise TransformUnavailableError(f"no {source}")
        return at_x(stands[source] - stands[target])

    fixed_pose = pose


def test_a_told_pose_is_that_of_the_base_in_whatever_frame_stands_still_in_the_map():
    parts = Parts()
    settings = NodeSettings(mode="localization", map_folder="hall", base_frame="base_link")
    sources = Sources(parts, SimpleNamespace(settings=settings))
    scan = Scan(np.ones((1, 3)), 9 * S, "lidar")
    for frame, x in (("grid", 107.25), ("map", 7.25), ("", 7.25)):
        parts.inputs.told.add(StampedPose(8 * S, frame, at_x(7.0)))
        told = sources.told(scan)
        assert told.stamp_ns == 8 * S
        np.testing.assert_allclose(told.T_map_cloud, at_x(x))
    assert sources.told(scan) is None
    parts.inputs.told.add(StampedPose(8 * S, "moon", at_x(7.0)))
    with pytest.raises(TransformUnavailableError, match="no moon"):
        sources.told(scan)
