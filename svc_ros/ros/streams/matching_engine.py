"""Mode `scan_matching`: each cloud of a stream becomes one decision and, if accepted, a pose in the odometry frame."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.registration import verify
from svc_ros.core.scan import Array, Scan
from svc_ros.io.results import result_to_json
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.pipeline.stream import StreamDecision, refuse_scan
from svc_ros.ros.streams.decision import CloudReader, Decision, Look, drop_decision
from svc_ros.ros.streams.odometry_track import OdometryTrack
from svc_ros.ros.streams.registrar import made_up_scan, warm_up
from svc_ros.ros.streams.worker import CloudLabel, DropJob, Job, PairJob, ScanJob


class MatchingEngine:
    """Follows one sensor; a change of the configuration begins a new odometry.

    origin_of: see CloudReader; base_of: T_base_cloud (4, 4) at a stamp, (frame, stamp_ns) -> (4, 4), the identity where
    no base is asked for; odometry_frame: name of the frame in which poses are told.
    """

    def __init__(
        self, origin_of: Callable[[str, int], Array], base_of: Callable[[str, int], Array], odometry_frame: str
    ) -> None:
        self._reader, self._base_of, self._odometry_frame = CloudReader(origin_of), base_of, odometry_frame
        self._matcher: ScanMatcher | None = None
        self._config: Config | None = None
        self._track = OdometryTrack()
        self._last: StreamDecision | None = None

    def process(self, job: Job, config: Config) -> list[Decision]:
        """The one decision on one scan; see Engine."""
        if isinstance(job, DropJob):
            return [drop_decision(job, config)]
        assert not isinstance(job, PairJob)
        start = time.monotonic()
        decision, T_base_cloud = self._decide(job, config)
        estimate = self._track.add(decision, T_base_cloud)
        if decision.scans is not None:
            self._last = decision
        answer = from_stream(decision, job, start, self._odometry_frame, self._track.T_told_odom)
        return [dataclasses.replace(answer, odometry=estimate)]

    def reset(self) -> None:
        """The next scan is where odometry begins."""
        self._matcher, self._last = None, None
        self._track = OdometryTrack()

    def warm_up(self, config: Config) -> None:
        """See `warm_up_matching`."""
        warm_up_matching(config)

    def judge_again(self, config: Config) -> dict[str, Any]:
        """Judge the last scan's pose once more, against the same keyframe; see Engine."""
        return judge_stream_again(self._last, config)

    def numbers(self) -> dict[str, Any]:
        """Keyframes that are kept."""
        matcher = self._matcher
        return {"keyframes": matcher.num_keyframes if matcher is not None else 0}

    def _decide(self, job: ScanJob, config: Config) -> tuple[StreamDecision, Array]:
        """The decision, and T_base_cloud (4, 4)."""
        if self._matcher is None or config != self._config:
            self.reset()
            self._matcher, self._config = ScanMatcher(config), config
        label = job.cloud.label
        try:
            scan = self._reader.scan(job.cloud)
            T_base_cloud = self._base_of(label.frame_id, label.stamp_ns)
        except Exception as error:
            return refuse_scan(label.stamp_ns, label.frame_id, error, config), np.eye(4)
        (decision,) = self._matcher.add(scan)
        return decision, T_base_cloud


def from_stream(
    decision: StreamDecision, job: ScanJob, start_s: float, odometry_frame: str, T_told_odom: Array
) -> Decision:
    """The node's form of a stream's decision. start_s: when the work on it began (steady clock)."""
    now, came = time.monotonic(), job.cloud.received_s
    timings = {"queue_ms": 1e3 * (start_s - came), "latency_ms": 1e3 * (now - came)}
    source = CloudLabel(decision.source_stamp_ns, decision.source_frame)
    target = CloudLabel(decision.target_stamp_ns, decision.target_frame)
    look = look_from_stream(decision, odometry_frame, T_told_odom)
    return Decision(decision.result, source, target, timings, look, origin=decision.origin)


def look_from_stream(decision: StreamDecision, odometry_frame: str, T_told_odom: Array) -> Look | None:
    """Drawn in the odometry frame where the target's place in it is known, else in the target's own."""
    T = decision.result.best_candidate
    if decision.scans is None or T is None:
        return None
    source, target = decision.scans
    if decision.T_odom_target is None:
        return Look(source.points, source, target, T, np.eye(4), decision.target_frame)
    return Look(source.points, source, target, T, T_told_odom @ decision.T_odom_target, odometry_frame)


def judge_stream_again(last: StreamDecision | None, config: Config) -> dict[str, Any]:
    """Verify the pose of a stream's decision once more; InputError where there is none."""
    if last is None or last.scans is None or last.result.best_candidate is None:
        raise InputError("expected a scan whose pose was judged, found none since the start or the last reset")
    result = verify(*last.scans, last.result.best_candidate, config)
    stamps = {"source_stamp_ns": last.source_stamp_ns, "target_stamp_ns": last.target_stamp_ns}
    return result_to_json(result, **stamps, origin=last.origin)


@functools.lru_cache(maxsize=8)
def warm_up_matching(config: Config) -> None:
    """Match a small made-up scan with itself, twice, so that everything is imported and compiled; once in a process.

    And register as a recovery will.
    """
    warm_up(config)
    scan, matcher = made_up_scan(config), ScanMatcher(config)
    for stamp_ns in (1, 100_000_001, 200_000_001):
        matcher.add(Scan(scan.points, stamp_ns))
