"""Mode `loop_closure`: scans of a stream become loops to earlier places, pairs from outside become judged candidates.

Of the accepted loops between keyframes a pose graph is kept, to be written as a g2o file.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Scan
from svc_ros.io.g2o import PoseGraph, write_g2o
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.agreement import pair_of
from svc_ros.pipeline.decide import refused
from svc_ros.pipeline.loop_closure import LoopCloser, LoopQuestion, judge_scans
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StampOrder, StreamDecision, refuse_scan
from svc_ros.replay.stream import odometry_by_matching
from svc_ros.ros.streams.decision import (
    CloudReader,
    Decision,
    Judgement,
    Outcome,
    drop_decision,
    labels,
    named_side,
)
from svc_ros.ros.streams.matching_engine import from_stream, judge_stream_again
from svc_ros.ros.streams.registrar import made_up_scan, warm_up
from svc_ros.ros.streams.worker import Cloud, CloudLabel, DropJob, Job, PairJob, ScanJob

_log = logging.getLogger(__name__)
OdometryOf = Callable[[Scan], Array | None]


class LoopSources(Protocol):
    """Where a loop closer's inputs come from, besides the clouds."""

    odometry_frame: str

    def origin(self, frame: str, stamp_ns: int) -> Array:
        """See CloudReader."""
        ...

    def guess(self, stamp_ns: int) -> Array | None:
        """The guess (4, 4) for a pair from outside, by the source's stamp."""
        ...

    def odometry(self, scan: Scan) -> Array | None:
        """Where odometry says that the scan stands; TransformUnavailableError where it says nothing."""
        ...


class LoopEngine:
    """Follows the sensor and says what is to be judged; a change of the configuration begins a new set of keyframes.

    Motion is followed here, so that no scan has to wait for candidates, which other threads judge.
    own_odometry: take the sensor's own motion (scan matching) instead of what `sources` say; wait: returns when all
    that was to be judged so far has its decision; graph_file: where to write the pose graph when it is finished, None
    for nowhere.
    """

    def __init__(
        self, sources: LoopSources, own_odometry: bool, wait: Callable[[], None], graph_file: Path | None = None
    ) -> None:
        self._sources, self._own_odometry, self._wait = sources, own_odometry, wait
        self._reader, self._order = CloudReader(sources.origin), StampOrder()
        self._graph_file, self._num_graphs = graph_file, 0
        self._closer: LoopCloser | None = None
        self._odometry_of: OdometryOf = sources.odometry
        self._found = threading.Lock()  # for the three that follow, which several threads write
        self._num_changes = 0
        self._loops: dict[tuple[int, int], StreamDecision] = {}  # accepted by the last word on each pair
        self._last: StreamDecision | None = None

    def process(self, job: Job, config: Config) -> Outcome:
        """A scan without candidates has no decision, others one for each candidate. See Engine."""
        if isinstance(job, DropJob):
            return [drop_decision(job, config)]
        start = time.monotonic()
        if isinstance(job, PairJob):
            return self._open_pair(job, config, start)
        closer = self._closer_for(job, config)
        found = self._propose(closer, job)
        if isinstance(found, LoopQuestion):
            judge = functools.partial(self._judge, closer, found, job, start)
            return Judgement(job, config, judge, functools.partial(self._settle, closer))
        return [from_stream(d, job, start, self._sources.odometry_frame, np.eye(4)) for d in found]

    def reset(self) -> None:
        """Wait for what is being judged, write the pose graph, and forget everything.

        Raises InputError if the file cannot be written.
        """
        self._wait()
        try:
            self.write_graph()
        finally:
            self._num_graphs += self._closer is not None and len(self._closer.keyframe_poses) > 0
            self._closer, self._last = None, None
            with self._found:
                self._num_changes += bool(self._loops)
                self._loops = {}
            self._order.clear()

    def warm_up(self, config: Config) -> None:
        """See `warm_up_loops`."""
        warm_up_loops(config, self._own_odometry)

    def judge_again(self, config: Config) -> dict[str, Any]:
        """Judge the last candidate's pose once more; see Engine."""
        return judge_stream_again(self._last, config)

    def numbers(self) -> dict[str, Any]:
        """Keyframes that are kept, and accepted loops so far."""
        closer = self._closer
        return {"keyframes": closer.num_keyframes if closer is not None else 0, "loops": len(self._loops)}

    def write_graph(self) -> Path | None:
        """Write keyframes and loops so far; the file, or None where there is nothing to write or no name for it.

        Graphs of later resets get a number of their own. Safe from any thread. Raises InputError.
        """
        found = self.graph()
        if self._graph_file is None or found is None:
            return None
        path = _numbered(self._graph_file, self._num_graphs)
        write_g2o(path, found[2])
        return path

    def graph(self) -> tuple[int, Trajectory, PoseGraph] | None:
        """How often the loops have changed, odometry of the keyframes, and both as a graph; safe from any thread.

        None where there are no keyframes with odometry.
        """
        with self._found:
            num_changes, closer, loops = self._num_changes, self._closer, list(self._loops.values())
        keyframes = None if closer is None else closer.keyframe_poses
        if closer is None or keyframes is None or len(keyframes) == 0:
            return None
        known = set(keyframes.stamps_ns.tolist())
        loops.sort(key=lambda loop: loop.source_stamp_ns)  # several threads found them
        between = [d for d in loops if {d.source_stamp_ns, d.target_stamp_ns} <= known]
        return num_changes, keyframes, build_pose_graph(keyframes, between, closer.config.covariance)

    def _closer_for(self, job: ScanJob, config: Config) -> LoopCloser:
        """The one that the scan belongs to: a new one where the configuration is new or time begins anew."""
        if self._closer is None:
            return self._begin(config)
        if config != self._closer.config or self._order.is_jump(job.cloud.stamp_ns):
            try:
                self.reset()
            except InputError:
                _log.exception("keyframes and loops are forgotten unwritten")
            return self._begin(config)
        return self._closer

    def _propose(self, closer: LoopCloser, job: ScanJob) -> LoopQuestion | list[StreamDecision]:
        label = job.cloud.label
        try:
            scan = self._reader.scan(job.cloud)
            self._order.lateness(label.stamp_ns)
            return closer.propose(scan, self._odometry_of(scan))
        except Exception as error:
            return [refuse_scan(label.stamp_ns, label.frame_id, error, closer.config)]

    def _begin(self, config: Config) -> LoopCloser:
        self._odometry_of = odometry_by_matching(config) if self._own_odometry else self._sources.odometry
        self._closer = LoopCloser(config)
        return self._closer

    def _open_pair(self, job: PairJob, config: Config, start_s: float) -> Outcome:
        """A candidate that somebody else proposes."""
        try:
            source, target = self._scan("source", job.source), self._scan("target", job.target)
            guess = self._sources.guess(job.source.stamp_ns)
        except Exception as error:
            return [_given(job, refused(error, config), start_s)]
        return Judgement(job, config, lambda: [_given(job, judge_scans(source, target, guess, config), start_s)])

    def _scan(self, side: str, cloud: Cloud) -> Scan:
        try:
            return self._reader.scan(cloud)
        except (InputError, TransformUnavailableError) as error:
            raise named_side(side, error) from error

    # on the threads that judge

    def _judge(self, closer: LoopCloser, question: LoopQuestion, job: ScanJob, start_s: float) -> list[Decision]:
        found = closer.judge(question)
        with self._found:
            last = next((d for d in reversed(found) if d.scans is not None), None)
            if last is not None and (self._last is None or last.source_stamp_ns > self._last.source_stamp_ns):
                self._last = last
        decisions = [from_stream(d, job, start_s, self._sources.odometry_frame, np.eye(4)) for d in found]
        keyframes = closer.keyframe_poses.stamps_ns
        return [
            dataclasses.replace(d, vertices=_vertices(d, keyframes), loop=loop)
            for d, loop in zip(decisions, found, strict=True)
        ]

    def _settle(self, closer: LoopCloser, decisions: list[Decision]) -> list[Decision]:
        """Hold the decisions against those that were told before; what that changes of earlier ones follows."""
        told: list[Decision] = []
        for decision in decisions:
            if decision.loop is None:
                told.append(decision)
                continue
            first, *later = closer.settle([decision.loop])
            told += [dataclasses.replace(decision, result=first.result, loop=None), *map(_revision, later)]
            with self._found:
                for loop in (first, *later):
                    self._num_changes += self._loops.pop(pair_of(loop), None) is not None or loop.result.accepted
                    if loop.result.accepted:
                        self._loops[pair_of(loop)] = _edge_only(loop)
        keyframes = closer.keyframe_poses.stamps_ns
        return [dataclasses.replace(d, vertices=d.vertices or _vertices(d, keyframes)) for d in told]


def _given(job: PairJob, result: RegistrationResult, start_s: float) -> Decision:
    came = max(job.source.received_s, job.target.received_s)
    timings = {"queue_ms": 1e3 * (start_s - came), "latency_ms": 1e3 * (time.monotonic() - came)}
    return Decision(result, *labels(job), timings, origin="given")


def _revision(loop: StreamDecision) -> Decision:
    source = CloudLabel(loop.source_stamp_ns, loop.source_frame)
    target = CloudLabel(loop.target_stamp_ns, loop.target_frame)
    return Decision(loop.result, source, target, origin=loop.origin)


def _vertices(decision: Decision, keyframes_ns: NDArray[np.int64]) -> tuple[int, int] | None:
    """Numbers of source and target in the pose graph; None for scans that are not in it."""
    ends = [label.stamp_ns for label in (decision.source, decision.target) if label is not None]
    if len(ends) != 2 or not np.isin(ends, keyframes_ns).all():
        return None
    source, target = np.searchsorted(keyframes_ns, ends).tolist()
    return source, target


def _edge_only(loop: StreamDecision) -> StreamDecision:
    """What the pose graph needs of a loop: of a long day there are many, and evidence is large."""
    return dataclasses.replace(loop, scans=None, result=dataclasses.replace(loop.result, evidence=None))


def _numbered(path: Path, number: int) -> Path:
    """loops.g2o, loops_2.g2o, loops_3.g2o ..."""
    return path if number == 0 else path.with_stem(f"{path.stem}_{number + 1}")


@functools.lru_cache(maxsize=8)
def warm_up_loops(config: Config, own_odometry: bool) -> None:
    """Register, match and look at a small made-up scene, so that everything is compiled; once in a process."""
    warm_up(config)
    scan, closer, own = made_up_scan(config), LoopCloser(config), odometry_by_matching(config)
    for stamp_ns in (1, 1_000_000_001 + round(1e9 * config.loop_closure.min_gap_s)):
        stamped = Scan(scan.points, stamp_ns)
        closer.add(stamped, own(stamped) if own_odometry else None)
