"""Where the sensor is, scan by scan: motion by KISS-ICP, judged along sight lines, recovered by global registration.

Every scan gets one decision. A pose is told only if it was accepted against a scan that was accepted before, so that
a chain of judged poses leads back to the first scan, whose frame is the odometry frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.pipeline.decide import register_pair
from svc_ros.pipeline.keyframes import Keyframe, KeyframeStore
from svc_ros.pipeline.motion import KissMotion, Motion
from svc_ros.pipeline.place import compare_places
from svc_ros.pipeline.place_search import most_alike
from svc_ros.pipeline.stream import StampOrder, StreamDecision, decide_in_order, demand, leave_undecided


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One judged pose of the current scan."""

    result: RegistrationResult
    target: Keyframe
    origin: str
    scans: tuple[PreparedScan, PreparedScan]


class ScanMatcher:
    """Follows one sensor; not safe for use from several threads at once.

    The first scan that can be used is the origin. Raises MissingDependencyError where kiss-icp is not installed.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._order = StampOrder()
        self._keyframes = KeyframeStore(config.scan_matching.max_keyframes)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next scan is the origin again."""
        self._order.clear()
        self._keyframes.clear()
        self._motion = KissMotion(self._config)
        self._current: Keyframe | None = None  # what scans are judged against
        self._last: Keyframe | None = None  # the last scan that was accepted

    @property
    def num_keyframes(self) -> int:
        """Keyframes that are kept now."""
        return len(self._keyframes)

    def add(self, scan: Scan) -> list[StreamDecision]:
        """Take the next scan and return its one decision; a scan that cannot be used changes nothing.

        Raises ConfigError and MissingDependencyError only. A stamp far back in time starts everything anew, a smaller
        step back is `dropped` as stale.
        """
        return decide_in_order(scan, self._order, self._config, self.reset, lambda scan: [self._decide(scan)])

    def _decide(self, scan: Scan) -> StreamDecision:
        current = self._current
        if current is not None and scan.frame_id != current.scan.frame_id:
            raise InputError(f"expected a scan in frame {current.scan.frame_id!r}, found {scan.frame_id!r}")
        # Where the sensor may be, and the scan without its own motion.
        motion = self._motion.estimate(scan)
        this = Keyframe(prepare(motion.scan, self._config), None, self._config)
        if current is None:
            return self._begin(motion, this)
        # The first pose that is accepted counts; what is tried later costs more.
        attempts: list[_Attempt] = []
        for attempt in self._attempts(motion, this, current):
            attempts.append(attempt)
            if attempt.result.accepted:
                return self._accept(motion, this, attempt)
        best = max(attempts, key=_closeness_to_acceptance)
        return _decision(this, best)

    def _attempts(self, motion: Motion, this: Keyframe, current: Keyframe) -> Iterator[_Attempt]:
        """Poses of the scan, judged one after the other, cheapest first."""
        yield from self._judged(motion, this, current, "motion")
        yield from self._judged(self._turned(motion, this), this, current, "turn")
        for target in self._recovery_targets(this):
            result = register_pair(this.features, target.features, self._config)
            result = demand(result, self._config.scan_matching.min_recovery_probability)
            yield _Attempt(self._trusted(result, target), target, "registration", (this.scan, target.scan))

    def _judged(self, motion: Motion, this: Keyframe, current: Keyframe, origin: str) -> Iterator[_Attempt]:
        """The motion against the keyframe, and against the last accepted scan where the keyframe sees too little.

        Not where the keyframe contradicts the pose: it shows a longer way, and with it what is wrong, more clearly.
        """
        attempt = self._verified(motion, this, current, origin)
        yield attempt
        sees_too_little = attempt.result.reason in (Reason.LOW_OVERLAP, Reason.INSUFFICIENT_EVIDENCE)
        if sees_too_little and self._last is not None and self._last is not current:
            yield self._verified(motion, this, self._last, origin)

    def _verified(self, motion: Motion, this: Keyframe, target: Keyframe, origin: str) -> _Attempt:
        T_target_source = se3.invert(_pose(target)) @ motion.T_odom_scan
        num = self._config.scan_matching.verify_points
        scans = this.thinned(num), target.thinned(num)
        result = verify(*scans, T_target_source, self._config)
        return _Attempt(self._trusted(result, target), target, origin, scans)

    def _trusted(self, result: RegistrationResult, target: Keyframe) -> RegistrationResult:
        """The result as far as odometry can be built on it.

        Where surfaces hardly resist a shift (a corridor) a pose may be off by what no sight line tells. Against one
        keyframe that stays as it is; with a new target for each scan it would add up.
        """
        result = demand(result, self._config.scan_matching.min_probability)
        if not result.accepted or result.evidence is None or target is self._current:
            return result
        found, wanted = result.evidence.weakest_constraint, self._config.decision.weak_constraint
        if found >= wanted:
            return result
        why = f"surfaces that resist a shift by {found:.3f} only, {wanted:g} is wanted of other scans than the keyframe"
        return leave_undecided(result, Reason.AMBIGUOUS, why)

    def _turned(self, motion: Motion, this: Keyframe) -> Motion:
        """The motion from where the last accepted scan stood, turned as the looks of both places say."""
        assert self._last is not None
        _, T_last_this = compare_places(this.look, self._last.look)
        return self._motion.estimate_again(motion, _pose(self._last) @ T_last_this)

    def _recovery_targets(self, this: Keyframe) -> list[Keyframe]:
        """The last accepted scan, and of the keyframes those whose places look most like this one."""
        assert self._last is not None
        others = [keyframe for keyframe in reversed(self._keyframes) if keyframe is not self._last]
        num = self._config.scan_matching.recovery_attempts
        found = most_alike(this.look, [keyframe.look for keyframe in others], num)
        return [self._last, *(others[k] for k, _ in found)][:num]

    def _begin(self, motion: Motion, this: Keyframe) -> StreamDecision:
        """The first scan stands where odometry begins, by definition."""
        origin = np.eye(4)
        floor = self._config.covariance
        variances = [floor.floor_translation_m**2] * 3 + [np.radians(floor.floor_rotation_deg) ** 2] * 3
        result = RegistrationResult(
            Verdict.ACCEPTED, Reason.OK, self._config.method, origin, origin, np.diag(variances), 1.0,
            detail="the first scan: odometry begins here",
        )  # fmt: skip
        itself = Keyframe(this.scan, origin, self._config)
        return self._accept(motion, this, _Attempt(result, itself, "start", (this.scan, this.scan)))

    def _accept(self, motion: Motion, this: Keyframe, attempt: _Attempt) -> StreamDecision:
        """Go on from the judged pose."""
        assert attempt.result.T_target_source is not None
        this.T_odom_scan = se3.nearest_pose(_pose(attempt.target) @ attempt.result.T_target_source)
        self._motion.keep(motion, this.T_odom_scan, attempt.origin == "motion")
        self._last = this
        self._current = attempt.target
        if attempt.origin == "start" or self._is_far(attempt):
            self._current = this
            self._keyframes.add(this)
        return _decision(this, attempt)

    def _is_far(self, attempt: _Attempt) -> bool:
        """True if the accepted scan should be the next keyframe."""
        limits, result = self._config.scan_matching, attempt.result
        assert result.T_target_source is not None
        assert result.evidence is not None
        distance = float(np.linalg.norm(result.T_target_source[:3, 3]))
        return result.evidence.oriented_overlap_ratio < limits.keyframe_overlap or distance > limits.keyframe_distance_m


def _closeness_to_acceptance(attempt: _Attempt) -> tuple[bool, float]:
    return attempt.result.verdict is Verdict.UNDECIDED, attempt.result.probability or 0.0


def _pose(keyframe: Keyframe) -> se3.Array:
    assert keyframe.T_odom_scan is not None
    return keyframe.T_odom_scan


def _decision(this: Keyframe, attempt: _Attempt) -> StreamDecision:
    source, target = this.scan, attempt.target.scan
    return StreamDecision(
        attempt.result, source.stamp_ns, target.stamp_ns, source.frame_id, target.frame_id,
        this.T_odom_scan if attempt.result.accepted else None, attempt.origin, attempt.scans, _pose(attempt.target),
    )  # fmt: skip
