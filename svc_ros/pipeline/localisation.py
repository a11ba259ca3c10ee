"""Where a sensor is in a map that was made before: found without a guess, followed, and said to be lost when it is."""

from __future__ import annotations

import dataclasses
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import ConfigError
from svc_ros.core.registration import prepare
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, Scan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.neighbours import (
    KeyframeMap,
    Placed,
    is_of_one_wall,
    is_same_place,
    judge_among_neighbours,
    nowhere,
    shows_enough,
)
from svc_ros.pipeline.own_steps import OwnSteps
from svc_ros.pipeline.relocalisation import DRIFT, WaitingPlaces, find_in_map
from svc_ros.pipeline.stream import StampOrder, StreamDecision, decide_in_order, demand, leave_undecided


class LocalisationState(str, Enum):
    """Whether the sensor's place in the map is known."""

    SEARCHING = "searching"  # it was not known yet
    LOCALISED = "localised"
    LOST = "lost"  # it was known


class Localiser:
    """Finds one sensor in a map and follows it there; for one thread at a time.

    Raises ConfigError where scans would be prepared or described in another way than those of the map.
    """

    def __init__(self, keyframes: KeyframeMap, config: Config) -> None:
        for name in ("preprocess", "features"):
            if getattr(config, name) != getattr(keyframes.config, name):
                raise ConfigError(f"{name}: expected the values that the map was made with, found others")
        self._map, self._config = keyframes, config
        self._order, self._steps, self._waiting = StampOrder(), OwnSteps(config), WaitingPlaces(config, self._judge)
        self.reset()

    def reset(self) -> None:
        """Forget where the sensor is."""
        self._order.clear()
        self._steps.clear()
        self._waiting.clear()
        self._state = LocalisationState.SEARCHING
        self._T_map_odom: Array | None = None
        self._confirmed: tuple[int, Array] | None = None  # stamp and place of the last scan that was accepted
        self._is_told_wrong = False

    @property
    def config(self) -> Config:
        """What it was made with."""
        return self._config

    @property
    def keyframes(self) -> KeyframeMap:
        """The map."""
        return self._map

    @property
    def state(self) -> LocalisationState:
        """After the last scan."""
        return self._state

    @property
    def is_told_wrong(self) -> bool:
        """Whether the last pose that others told is wrong."""
        return self._is_told_wrong

    @property
    def T_map_odom(self) -> Array | None:
        """Where odometry begins in the map, (4, 4); None unless localised.

        Where odometry says nothing its frame is the localiser's own, and begins anew where scans do not join.
        """
        return self._T_map_odom

    def add(
        self, scan: Scan, T_odom_scan: ArrayLike | None = None, T_map_told: ArrayLike | None = None
    ) -> list[StreamDecision]:
        """Take the next scan; returns the decision on its place, and before it that on the pose which others tell.

        T_odom_scan: (4, 4), where odometry says that the scan's frame stands, None where it says nothing; T_map_told:
        (4, 4), where others say that it stands in the map. The odometry frame of a decision is that of the map; origin:
        `motion` (as odometry has it), `place` (found by this scan alone), `run` (with those before it), `told`. An
        accepted decision is a place; any other leaves the scan without one. A scan that cannot be used is one decision
        that says why. Raises ConfigError and MissingDependencyError only.
        """

        def decide(scan: Scan) -> list[StreamDecision]:
            odom = None if T_odom_scan is None else se3.check_pose(T_odom_scan, "T_odom_scan")
            told = None if T_map_told is None else se3.nearest_pose(se3.check_pose(T_map_told, "T_map_told"))
            return self._decide(Keyframe(prepare(scan, self._config), odom, self._config), told)

        decisions = decide_in_order(scan, self._order, self._config, self.reset, decide)
        self.pass_over(scan.stamp_ns)
        return decisions

    def pass_over(self, stamp_ns: int) -> None:
        """Of a scan that nobody could look at: a place that none has confirmed for too long is lost all the same."""
        if self._T_map_odom is not None and self._is_overdue(stamp_ns):
            self._lose()

    def _decide(self, this: Keyframe, T_map_told: Array | None) -> list[StreamDecision]:
        this.T_odom_scan, is_joined = self._steps.follow(this, this.T_odom_scan)
        guesses = [] if T_map_told is None else [T_map_told]
        if not is_joined:
            guesses += self._forget_odometry()
        placed, origin = self._follow(this, guesses) if self._T_map_odom is not None else self._search(this, guesses)
        decisions = [self._decision(this, placed, origin)]
        if T_map_told is not None:
            told = self._judge_told(this, T_map_told, placed)
            self._is_told_wrong = told.result.verdict is Verdict.REJECTED
            decisions.insert(0, self._decision(this, told, "told"))
        return decisions

    def _forget_odometry(self) -> list[Array]:
        """What was known in another odometry frame is of no use; but the sensor may not be far from where it was."""
        self._waiting.clear()
        if self._T_map_odom is not None:
            self._lose()
        return [] if self._confirmed is None else [self._confirmed[1]]

    def _follow(self, this: Keyframe, guesses: list[Array]) -> tuple[Placed, str]:
        """The place that odometry leads to, judged; searched anew where that is contradicted."""
        assert self._T_map_odom is not None
        assert this.T_odom_scan is not None
        predicted = self._T_map_odom @ this.T_odom_scan
        placed = self._judge(this, predicted)
        if placed.result.accepted and placed.probability >= self._config.localization.min_probability:
            return self._confirm(this, placed), "motion"
        if placed.result.verdict is Verdict.REJECTED:
            found, origin = self._search(this, [*guesses, predicted])
            if found.result.accepted:
                return found, origin
        if self._is_contradicted(placed) or self._is_overdue(this.scan.stamp_ns):
            self._lose()
        if placed.result.accepted:
            why = f"probability {placed.probability:.2f} only where odometry leads to"
            result = leave_undecided(placed.result, Reason.INSUFFICIENT_EVIDENCE, why)
            placed = dataclasses.replace(placed, result=result)
        return placed, "motion"

    def _search(self, this: Keyframe, guesses: list[Array]) -> tuple[Placed, str]:
        """A place anywhere in the map, where this scan is sure of it or agrees with those before."""
        self._waiting.ask(this)
        found = find_in_map(this, self._map, guesses, self._config)
        accepted = [placed for placed in found if placed.result.accepted]
        self._waiting.add(accepted, this)
        settled = self._waiting.settled(accepted)
        if settled is not None:
            placed, is_alone = settled
            return self._confirm(this, placed), "place" if is_alone else "run"
        if accepted:
            result = leave_undecided(accepted[0].result, Reason.AMBIGUOUS, self._waiting.describe())
            return dataclasses.replace(accepted[0], result=result), "place"
        return found[0] if found else nowhere("no keyframe of the map to register to", self._config), "place"

    def _judge(self, this: Keyframe, T_map_scan: Array) -> Placed:
        num_points = self._config.scan_matching.verify_points
        return judge_among_neighbours(this, T_map_scan, self._map, self._config, num_points)

    def _confirm(self, this: Keyframe, placed: Placed) -> Placed:
        assert this.T_odom_scan is not None
        self._T_map_odom = se3.nearest_pose(placed.T_map_scan @ se3.invert(this.T_odom_scan))
        self._confirmed = this.scan.stamp_ns, placed.T_map_scan
        self._state = LocalisationState.LOCALISED
        self._waiting.clear()
        return placed

    def _is_contradicted(self, predicted: Placed) -> bool:
        """Whether the scan shows another place than odometry leads to; what shows one wall shows none."""
        is_elsewhere = predicted.result.verdict is Verdict.REJECTED and len(self._waiting) > 0
        is_beside = predicted.is_moved and not is_of_one_wall(predicted, self._config)
        return is_elsewhere or predicted.is_denied or is_beside

    def _is_overdue(self, stamp_ns: int) -> bool:
        assert self._confirmed is not None
        return stamp_ns - self._confirmed[0] > 1e9 * self._config.localization.lost_after_s

    def _lose(self) -> None:
        self._T_map_odom, self._state = None, LocalisationState.LOST

    def _judge_told(self, this: Keyframe, T_map_told: Array, own: Placed) -> Placed:
        """The verdict on a pose that others tell, as it was told: refinement does not excuse what it had to move."""
        if own.result.accepted and is_same_place(T_map_told, own.T_map_scan, self._config):
            return own
        told, wanted = self._judge(this, T_map_told), self._config.localization.sure_probability
        if own.result.accepted:
            return _refuted(told, T_map_told, own.T_map_scan)
        if self._T_map_odom is not None and not (told.result.accepted and told.probability >= wanted):
            assert self._confirmed is not None
            assert this.T_odom_scan is not None
            predicted = self._T_map_odom @ this.T_odom_scan
            drift_m = DRIFT * float(np.linalg.norm(predicted[:3, 3] - self._confirmed[1][:3, 3]))
            if not is_same_place(T_map_told, predicted, self._config, drift_m):
                return _refuted(told, T_map_told, predicted)
            wanted = self._config.localization.min_probability
        is_little = told.result.reason is Reason.LOW_OVERLAP or not shows_enough(told, self._config)
        if told.result.verdict is Verdict.REJECTED and is_little:
            why = "what hardly overlaps the map is not wrong for that"
            return dataclasses.replace(told, result=leave_undecided(told.result, Reason.INSUFFICIENT_EVIDENCE, why))
        return dataclasses.replace(told, result=demand(told.result, wanted))

    def _decision(self, this: Keyframe, placed: Placed, origin: str) -> StreamDecision:
        source, result = this.scan, placed.result
        if placed.target is None:
            return StreamDecision(result, source.stamp_ns, source.stamp_ns, source.frame_id, source.frame_id)
        target = self._map.keyframe(placed.target).scan
        return StreamDecision(
            result, source.stamp_ns, target.stamp_ns, source.frame_id, target.frame_id,
            placed.T_map_scan if result.accepted else None, origin, placed.scans, self._map.poses[placed.target],
        )  # fmt: skip


def _refuted(told: Placed, T_map_told: Array, T_map_scan: Array) -> Placed:
    """A told pose that is not where the scan was found."""
    if told.result.verdict is Verdict.REJECTED:
        return told
    angle, distance = se3.pose_error(T_map_told, T_map_scan)
    detail = f"{angle:.1f} deg and {distance:.2f} m from where the scan is: {told.result.detail}"
    result: RegistrationResult = dataclasses.replace(
        told.result, verdict=Verdict.REJECTED, reason=Reason.AMBIGUOUS, T_target_source=None, covariance=None,
        probability=0.01, detail=detail,
    )  # fmt: skip
    return dataclasses.replace(told, result=result)
