"""What the modes that follow one stream of scans have in common: their decisions, and the order of stamps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from svc_ros.core.config import Config
from svc_ros.core.errors import ConfigError, MissingDependencyError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, PreparedScan, Scan
from svc_ros.pipeline.decide import dropped, refused

Answer = TypeVar("Answer")
_MAX_LATE_NS = 1_000_000_000  # no transport disorders scans by more; what is farther back is a jump in time


@dataclass(frozen=True, eq=False)
class StreamDecision:
    """The decision on one scan of a stream (source) against an earlier one (target).

    T_odom_source: (4, 4), where the source stands in the odometry frame: in scan matching present only if accepted, in
    loop closure as odometry said, whatever the verdict; in localisation that frame is the map's, as for T_odom_target,
    and a place is present only if accepted;
    origin: where the judged pose came from (start, motion, turn, registration, odometry, place, run, agreement, told,
    given), empty where nothing was judged; agreement is a later word on an earlier pair, without scans and evidence. A
    scan that was compared with nothing is its own target.
    scans: (source, target) as they were judged, which the evidence's indices point into; T_odom_target: (4, 4), where
    the target stands in the odometry frame. Both None where nothing was judged, the latter also without odometry.
    """

    result: RegistrationResult
    source_stamp_ns: int
    target_stamp_ns: int
    source_frame: str
    target_frame: str
    T_odom_source: Array | None = None
    origin: str = ""
    scans: tuple[PreparedScan, PreparedScan] | None = None
    T_odom_target: Array | None = None


def refuse_scan(stamp_ns: int, frame_id: str, error: Exception, config: Config) -> StreamDecision:
    """The decision on a scan, or on a cloud that is none, that `error` says cannot be used."""
    return StreamDecision(refused(error, config), stamp_ns, stamp_ns, frame_id, frame_id)


def drop_scan(stamp_ns: int, frame_id: str, reason: Reason, detail: str) -> StreamDecision:
    """The decision on a scan that was not looked at."""
    return StreamDecision(dropped(reason, detail), stamp_ns, stamp_ns, frame_id, frame_id)


def demand(result: RegistrationResult, min_probability: float) -> RegistrationResult:
    """The result itself, or undecided where it is accepted but less probable than that.

    One false pose spoils all that is built on it, and a stream brings another scan soon: it can wait to be sure.
    """
    if not result.accepted or result.probability is None or result.probability >= min_probability:
        return result
    why = f"probability {result.probability:.2f}, at least {min_probability:g} is wanted here"
    return leave_undecided(result, Reason.INSUFFICIENT_EVIDENCE, why)


def leave_undecided(result: RegistrationResult, reason: Reason, why: str) -> RegistrationResult:
    """A result whose pose is not to be used, or not to be called wrong, after all; its numbers stay."""
    return dataclasses.replace(
        result, verdict=Verdict.UNDECIDED, reason=reason, T_target_source=None, covariance=None,
        detail=f"{why}: {result.detail}",
    )  # fmt: skip


class StampOrder:
    """Tells late scans and jumps back in time (a bag that starts again) from the ordinary next scan."""

    def __init__(self) -> None:
        self._last_ns: int | None = None

    def is_jump(self, stamp_ns: int) -> bool:
        """True if the stamp is so far back that time starts anew; the order then forgets what was before."""
        jump = self._last_ns is not None and stamp_ns < self._last_ns - _MAX_LATE_NS
        if jump:
            self._last_ns = None
        return jump

    def lateness(self, stamp_ns: int) -> str:
        """Why the scan comes too late, in words; empty for the next one, which is then the last."""
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            return f"its stamp is {1e-9 * (self._last_ns - stamp_ns):.3f} s before that of an earlier scan, or the same"
        self._last_ns = stamp_ns
        return ""

    def clear(self) -> None:
        """Forget all stamps."""
        self._last_ns = None


def decide_in_order(
    scan: Scan,
    order: StampOrder,
    config: Config,
    reset: Callable[[], None],
    decide: Callable[[Scan], Answer],
) -> Answer | list[StreamDecision]:
    """Decide on a stream's next scan: after a reset where time starts anew, and not at all where it comes too late.

    A scan that cannot be used is one decision that says why. Raises ConfigError and MissingDependencyError only.
    """
    if order.is_jump(scan.stamp_ns):
        reset()
    late = order.lateness(scan.stamp_ns)
    if late:
        return [drop_scan(scan.stamp_ns, scan.frame_id, Reason.STALE, late)]
    return answer_or_refuse(scan, config, lambda: decide(scan))


def answer_or_refuse(
    scan: Scan | PreparedScan, config: Config, decide: Callable[[], Answer]
) -> Answer | list[StreamDecision]:
    """What `decide` returns, or what it raises as the one decision on the scan.

    Raises ConfigError and MissingDependencyError only.
    """
    try:
        return decide()
    except (ConfigError, MissingDependencyError):
        raise
    except Exception as error:
        return [refuse_scan(scan.stamp_ns, scan.frame_id, error, config)]
