"""Loops: earlier places that the sensor has come back to, each proposed cheaply and judged along sight lines.

Candidates come by odometry (where it says that the sensor stood near an earlier keyframe), by the look of the place
(where odometry has drifted, or where there is none), or from outside. Each is judged in the same way: a pose that
comes with it is verified, and if that is not accepted the two scans are registered globally. Where no keyframe is near
the one behind the sensor may still be in sight. Odometry is good so far, so that its pose is verified, and no other is
looked for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import ConfigError, MissingDependencyError
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Scan
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.agreeing.relations import IN_SIGHT
from svc_ros.pipeline.agreement import Agreement
from svc_ros.pipeline.decide import refused, register_pair
from svc_ros.pipeline.keyframes import Keyframe, KeyframeStore
from svc_ros.pipeline.place_search import most_alike
from svc_ros.pipeline.stream import StampOrder, StreamDecision, answer_or_refuse, decide_in_order, demand

Judge = Callable[[Keyframe, Keyframe, Array | None, Config], RegistrationResult]


@dataclass(frozen=True, eq=False)
class LoopCandidate:
    """An earlier keyframe that may show the same place. T_target_source: (4, 4), a guess, None where there is none;
    is_behind: the sensor has just come from there, and its guess is all that is judged."""

    target: Keyframe
    T_target_source: Array | None
    origin: str
    is_behind: bool = False


@dataclass(frozen=True, eq=False)
class LoopQuestion:
    """A new keyframe whose candidates are still to be judged, whatever becomes of the closer meanwhile.

    candidates: at least one; others: the keyframes among which the look of the place is asked where none of the
    candidates is accepted.
    """

    keyframe: Keyframe
    candidates: tuple[LoopCandidate, ...]
    others: tuple[Keyframe, ...]


class LoopCloser:
    """Keeps keyframes of one sensor and looks for loops among them.

    `add` does it in one step. In three, one thread proposes, scan after scan, and others judge meanwhile: what is
    judged depends on the scans before it and on no decision. What was judged is then settled, in the order of the
    scans, so that the decisions are the same.

    judge: what decides on a candidate, `judge_candidate` where nothing else is given.
    """

    def __init__(self, config: Config, judge: Judge | None = None) -> None:
        self._config, self._judge_candidate = config, judge or judge_candidate
        self._order = StampOrder()
        self._keyframes = KeyframeStore(config.loop_closure.max_keyframes)
        self._agreement = Agreement(config)
        self._poses: dict[int, Array] = {}  # of every keyframe so far by stamp, those that were given up too

    def reset(self) -> None:
        """Forget everything."""
        self._order.clear()
        self._keyframes.clear()
        self._agreement.reset()
        self._poses.clear()

    @property
    def config(self) -> Config:
        """What it was made with."""
        return self._config

    @property
    def keyframe_poses(self) -> Trajectory:
        """Odometry poses of all keyframes since the last reset, also of those that are no longer kept."""
        stamped = list(self._poses.items())  # one step, so that another thread may ask while scans are added
        poses = np.array([pose for _, pose in stamped]).reshape(-1, 4, 4)
        return Trajectory(np.array([stamp for stamp, _ in stamped], np.int64), poses)

    @property
    def num_keyframes(self) -> int:
        """Keyframes that are kept now."""
        return len(self._keyframes)

    @property
    def newest(self) -> Keyframe | None:
        """The keyframe that was added last; None before the first."""
        return next(reversed(self._keyframes), None)

    def add(self, scan: Scan, T_odom_scan: ArrayLike | None = None) -> list[StreamDecision]:
        """Take the next scan; returns one decision for each loop that was judged, and none for most scans.

        Each is followed by what it changes of earlier ones, see Agreement.

        T_odom_scan: (4, 4), where odometry says that the scan's frame stands; None where it says nothing. A scan that
        cannot be used is one decision that says why. Raises ConfigError and MissingDependencyError only.
        """
        found = self.propose(scan, T_odom_scan)
        return self.settle(self.judge(found)) if isinstance(found, LoopQuestion) else found

    def propose(self, scan: Scan, T_odom_scan: ArrayLike | None = None) -> LoopQuestion | list[StreamDecision]:
        """The first step of `add`: what is to be judged; for one thread at a time.

        An empty list where there is nothing to judge, and one decision where the scan cannot be used.
        """

        def ask(scan: Scan) -> LoopQuestion | list[StreamDecision]:
            return self._ask(scan, None if T_odom_scan is None else se3.check_pose(T_odom_scan, "T_odom_scan"))

        return decide_in_order(scan, self._order, self._config, self.reset, ask)

    def judge(self, question: LoopQuestion) -> list[StreamDecision]:
        """The second step of `add`: the decisions, at least one, each on its pair alone. Safe from any thread, for
        several questions at once.

        Raises ConfigError and MissingDependencyError only.
        """
        return answer_or_refuse(question.keyframe.scan, self._config, lambda: self._answer(question))

    def settle(self, decisions: list[StreamDecision]) -> list[StreamDecision]:
        """The third step of `add`, question after question: what other loops of the run make of the decisions."""
        return self._agreement.add(decisions, self.keyframe_poses)

    def _ask(self, scan: Scan, T_odom_scan: Array | None) -> LoopQuestion | list[StreamDecision]:
        # Only a scan that shows something new becomes a keyframe.
        if not self._is_new(T_odom_scan):
            return []
        this = Keyframe(prepare(scan, self._config), T_odom_scan, self._config)
        old = self._old_enough(this)
        reach_m = self._config.loop_closure.max_distance_m
        near = self._near(this, old, reach_m)
        behind = [] if near else self._near(this, old[-1:], IN_SIGHT * reach_m)
        known = [candidate.target for candidate in near + behind]
        others = [keyframe for keyframe in old if keyframe not in known]
        candidates = near or [
            *(dataclasses.replace(candidate, is_behind=True) for candidate in behind), *self._similar(this, others)
        ]  # fmt: skip
        self._keyframes.add(this)
        if T_odom_scan is not None:
            self._poses[scan.stamp_ns] = T_odom_scan
        if not candidates:
            return []
        return LoopQuestion(this, tuple(candidates), tuple(others if near else ()))

    def _answer(self, question: LoopQuestion) -> list[StreamDecision]:
        with question.keyframe.lent() as this:
            decisions = [self._judge(this, candidate) for candidate in question.candidates]
            # Where odometry leads to a loop it can be trusted; where it does not, the look of the place is asked.
            if not any(decision.result.accepted for decision in decisions):
                decisions += [self._judge(this, candidate) for candidate in self._similar(this, question.others)]
        return decisions

    def _is_new(self, T_odom_scan: Array | None) -> bool:
        """True if the sensor has moved far enough from the last keyframe, or if nobody knows."""
        last = self.newest
        if last is None or T_odom_scan is None or last.T_odom_scan is None:
            return True
        angle, distance = se3.pose_error(T_odom_scan, last.T_odom_scan)
        limits = self._config.loop_closure
        return distance >= limits.keyframe_distance_m or angle >= limits.keyframe_rotation_deg

    def _old_enough(self, this: Keyframe) -> list[Keyframe]:
        gap_ns = round(1e9 * self._config.loop_closure.min_gap_s)
        return [k for k in self._keyframes if this.scan.stamp_ns - k.scan.stamp_ns >= gap_ns]

    def _near(self, this: Keyframe, old: Iterable[Keyframe], reach_m: float) -> list[LoopCandidate]:
        """The nearest of those keyframes by odometry, within that reach."""
        limits = self._config.loop_closure
        found: list[tuple[float, LoopCandidate]] = []
        for keyframe in old:
            if this.T_odom_scan is None or keyframe.T_odom_scan is None:
                continue
            T = se3.invert(keyframe.T_odom_scan) @ this.T_odom_scan
            distance = float(np.linalg.norm(T[:3, 3]))
            if distance <= reach_m:
                found.append((distance, LoopCandidate(keyframe, T, "odometry")))
        found.sort(key=lambda pair: pair[0])
        return [candidate for _, candidate in found[: limits.max_near]]

    def _similar(self, this: Keyframe, old: Sequence[Keyframe]) -> list[LoopCandidate]:
        """Those of the keyframes whose places look most like this one."""
        limits = self._config.loop_closure
        looks = [keyframe.look for keyframe in old] if limits.max_similar else []
        found = most_alike(this.look, looks, limits.max_similar, limits.min_similarity)
        return [LoopCandidate(old[k], None, "place") for k, _ in found]

    def _judge(self, this: Keyframe, candidate: LoopCandidate) -> StreamDecision:
        with candidate.target.lent() as lent:
            if candidate.is_behind and candidate.T_target_source is not None:
                result = _verify(this, lent, candidate.T_target_source, self._config)
            else:
                result = self._judge_candidate(this, lent, candidate.T_target_source, self._config)
        source, target = this.scan, lent.scan
        return StreamDecision(
            result, source.stamp_ns, target.stamp_ns, source.frame_id, target.frame_id, this.T_odom_scan,
            candidate.origin, (source, target), candidate.target.T_odom_scan,
        )  # fmt: skip


def judge_candidate(
    source: Keyframe, target: Keyframe, T_target_source: ArrayLike | None, config: Config
) -> RegistrationResult:
    """Judge one candidate for a loop: its guess (4, 4) first, if it has one, then whatever registration finds.

    Of two answers that are not accepted the one of the registration counts, unless the guess is likely and it is not.
    """
    verified = None if T_target_source is None else _verify(source, target, T_target_source, config)
    if verified is not None and verified.accepted:
        return verified
    registered = demand(register_pair(source.features, target.features, config), config.loop_closure.min_probability)
    if verified is None or registered.accepted or not _is_likely(verified) or _is_likely(registered):
        return registered
    return verified


def _verify(source: Keyframe, target: Keyframe, T_target_source: ArrayLike, config: Config) -> RegistrationResult:
    return demand(verify(source.scan, target.scan, T_target_source, config), config.loop_closure.min_probability)


def _is_likely(result: RegistrationResult) -> bool:
    return result.probability is not None and result.probability >= 0.5


def judge_scans(source: Scan, target: Scan, T_target_source: ArrayLike | None, config: Config) -> RegistrationResult:
    """Judge a candidate that somebody else proposes; a scan or a guess that cannot be used is a rejection."""
    try:
        pair = [Keyframe(prepare(scan, config), None, config) for scan in (source, target)]
        return judge_candidate(pair[0], pair[1], T_target_source, config)
    except (ConfigError, MissingDependencyError):
        raise
    except Exception as error:
        return refused(error, config)
