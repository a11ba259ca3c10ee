"""When others are told where they are, and what is kept of what they tell; without a node."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.ros.streams.decision import Decision, MapPlace
from svc_ros.ros.topics.initial_pose import InitialPoseGuard
from svc_ros.ros.topics.told_poses import StampedPose, ToldPoses

KNOWN = MapPlace(np.eye(4), np.eye(6), np.eye(4))
UNSURE, LOST = MapPlace(T_map_odom=np.eye(4)), MapPlace()
RIGHT, WRONG, OPEN = Verdict.ACCEPTED, Verdict.REJECTED, Verdict.UNDECIDED
S = 1_000_000_000


def decision(verdict: Verdict, origin: str, place: MapPlace | None = None) -> Decision:
    T = np.eye(4) if verdict is RIGHT else None
    return Decision(RegistrationResult(verdict, Reason.OK, "svc", T, T), None, None, origin=origin, place=place)


class Scans:
    """Feeds a guard scan by scan; `told` are the numbers of the scans whose place was told."""

    def __init__(self) -> None:
        self.guard, self.num, self.told = InitialPoseGuard(), 0, []

    def see(self, place: MapPlace, others: Verdict | None = None, times: int = 1) -> None:
        for _ in range(times):
            if others is not None:
                assert not self.guard.allows(decision(others, "told"))
            if self.guard.allows(decision(RIGHT if place is KNOWN else OPEN, "motion", place)):
                self.told.append(self.num)
            self.num += 1


def test_the_third_sure_scan_in_a_row_is_told_and_no_other():
    scans = Scans()
    scans.see(LOST)
    scans.see(KNOWN, times=2)
    scans.see(UNSURE)
    scans.see(KNOWN, times=9)
    assert scans.told == [6]


def test_each_loss_is_told_of_once():
    scans = Scans()
    scans.see(KNOWN, times=5)
    scans.see(LOST)
    scans.see(KNOWN, times=5)
    assert scans.told == [2, 8]


def test_nothing_is_told_to_who_is_right_or_may_be():
    scans = Scans()
    scans.see(KNOWN, RIGHT, 5)
    scans.see(KNOWN, OPEN, 5)
    scans.see(KNOWN, WRONG, 2)
    scans.see(KNOWN, RIGHT)
    assert scans.told == []


@pytest.mark.parametrize("others", [WRONG, None], ids=["wrong", "silent"])
def test_who_was_told_and_stays_wrong_is_not_told_again_before_he_was_right(others):
    scans = Scans()
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, others, 20)
    scans.see(KNOWN, RIGHT)
    scans.see(KNOWN, others, 20)
    assert scans.told == [3, 24]


def test_a_wrong_pose_is_left_alone_by_who_is_not_sure_himself():
    scans = Scans()
    for place in (UNSURE, LOST):
        scans.see(place, WRONG, 9)
    assert scans.told == []


def test_a_reset_begins_anew():
    scans = Scans()
    scans.see(KNOWN, times=4)
    scans.guard.forget()
    scans.see(KNOWN, times=3)
    assert scans.told == [2, 6]


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
