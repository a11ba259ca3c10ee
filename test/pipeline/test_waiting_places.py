"""Places that wait for agreement: what settles one, by scans whose judgement is written down instead of computed."""

from __future__ import annotations

from typing import cast

import numpy as np
from decision_rows import evidence

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.neighbours import Placed
from svc_ros.pipeline.relocalisation import WaitingPlaces

CONFIG = preset("lidar_indoor")  # three scans, a metre apart
HERE, THERE = (se3.make_pose(np.eye(3), (x, 0.0, 0.0)) for x in (0.0, 50.0))


def judged(T: Array, verdict: Verdict, reason: Reason = Reason.OK, denied: float = 0.002) -> Placed:
    probability = 0.9 if verdict is Verdict.ACCEPTED else 0.1
    found = T if verdict is Verdict.ACCEPTED else None
    result = RegistrationResult(verdict, reason, "svc", found, T, probability=probability, evidence=evidence(denied))
    return Placed(result, T, 0)


def accepted(T: Array, denied: float = 0.002) -> Placed:
    return judged(T, Verdict.ACCEPTED, denied=denied)


class Run:
    """A drive along x, a scan each 1.1 m. `accept`, `deny`: for HERE and THERE the scans that do so."""

    def __init__(
        self, accept: dict[str, set[int]], deny: dict[str, set[int]] | None = None, denied: float = 0.002
    ) -> None:
        self.accept, self.deny, self.denied_share = accept, deny or {}, denied
        self.places = WaitingPlaces(CONFIG, self.judge)
        self.way: list[Array] = []

    def judge(self, this: Keyframe, T_map_scan: Array) -> Placed:
        assert this.T_odom_scan is not None
        k = next(k for k, T in enumerate(self.way) if np.array_equal(T, this.T_odom_scan))
        name = "there" if T_map_scan[0, 3] > 25.0 else "here"
        if k in self.accept[name]:
            return accepted(T_map_scan, self.denied_share)
        if k in self.deny.get(name, set()):
            return judged(T_map_scan, Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
        return judged(T_map_scan, Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE)

    def see(self, *found: Array, x: float | None = None) -> Placed | None:
        """The next scan, for which a search has found these places; the settled one."""
        T_odom_scan = se3.make_pose(np.eye(3), (1.1 * len(self.way) if x is None else x, 0.0, 0.0))
        self.way.append(T_odom_scan)
        this = Keyframe(cast("PreparedScan", None), T_odom_scan, CONFIG)
        self.places.ask(this)
        poses = [accepted(place @ T_odom_scan, self.denied_share) for place in found]
        self.places.add(poses, this)
        settled = self.places.settled(poses)
        assert settled is None or not settled[1]  # none is sure alone
        return None if settled is None else settled[0]


def assert_settled(run: Run, placed: Placed | None, place: Array) -> None:
    assert placed is not None
    np.testing.assert_allclose(placed.T_map_scan, place @ run.way[-1])


def test_scans_before_a_place_was_found_speak_for_it_too() -> None:
    run = Run({"here": {0, 1, 2}, "there": set()})
    assert run.see() is None
    assert run.see() is None
    assert_settled(run, run.see(HERE), HERE)


def test_of_two_that_are_alike_the_one_that_is_found_late_is_as_good() -> None:
    run = Run({"here": {0, 1, 2, 3, 4}, "there": {0, 1, 2, 3, 4}})
    assert run.see(HERE) is None
    assert run.see(HERE) is None
    assert [run.see(HERE, THERE) for _ in range(3)] == [None] * 3
    assert "5 of 3 scans" in run.places.describe()
    assert "2 places" in run.places.describe()


def test_what_only_one_scan_took_for_possible_holds_nothing_up() -> None:
    run = Run({"here": {0, 1, 2}, "there": {1}})
    assert run.see(HERE) is None
    assert run.see(THERE) is None
    assert_settled(run, run.see(), HERE)


def test_a_place_that_this_very_scan_takes_for_possible_does() -> None:
    run = Run({"here": {0, 1, 2, 3, 4}, "there": {2}})
    run.see(HERE)
    run.see()
    assert run.see(THERE) is None
    assert_settled(run, run.see(), HERE)


def test_a_scan_that_denies_outweighs_one_that_agrees() -> None:
    run = Run({"here": {1, 2, 3, 4}, "there": set()}, {"here": {0}})
    assert run.see() is None
    assert run.see(HERE) is None
    assert [run.see(), run.see()] == [None, None]
    assert_settled(run, run.see(), HERE)


def test_a_sensor_that_stands_agrees_with_itself_only() -> None:
    run = Run({"here": set(range(20)), "there": set()})
    for _ in range(6):
        assert run.see(HERE, x=0.0) is None
    assert "1 of 3 scans" in run.places.describe()
    for x in (1.1, 0.0, 1.1, 0.0):
        assert run.see(HERE, x=x) is None  # to and fro
    assert_settled(run, run.see(HERE, x=2.2), HERE)


def test_what_was_seen_long_ago_counts_no_more() -> None:
    run = Run({"here": {0, 1}, "there": set()})
    run.see(HERE)
    run.see()
    for _ in range(8):
        assert run.see() is None
    assert len(run.places) == 0


def test_scans_that_each_deny_a_part_agree_on_nothing() -> None:
    """As those of a corridor that is seen from the wrong end: each of them is probable, none of them good."""
    run = Run({"here": set(range(8)), "there": set()}, denied=0.03)
    assert [run.see(HERE) for _ in range(8)] == [None] * 8
    assert "5 of 3 scans" in run.places.describe()
