"""One thread that computes, fed by a bounded queue; callbacks only put jobs in.

No rclpy here: jobs, the queue and the registration of a pair are plain Python, testable without a node.
"""

from __future__ import annotations

import hashlib
import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.registration import extract_features, verify
from svc_ros.core.result import Reason, RegistrationResult
from svc_ros.core.scan import Array, Features, Scan
from svc_ros.io.point_cloud2 import scan_from_cloud
from svc_ros.pipeline.decide import dropped, refused, register_pair

_log = logging.getLogger(__name__)
_CACHED_SCANS = 3  # both of the last pair, and one that is on its way


@dataclass(frozen=True, eq=False)
class Cloud:
    """A received cloud: the message, its stamp and when it came (steady clock)."""

    message: Any
    stamp_ns: int
    received_s: float

    @property
    def label(self) -> CloudLabel:
        """The name of this cloud, without its data."""
        return CloudLabel(self.stamp_ns, str(self.message.header.frame_id))


@dataclass(frozen=True)
class CloudLabel:
    """Which cloud a decision is about."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class PairJob:
    """A pair that waits to be registered."""

    source: Cloud
    target: Cloud

    def drop(self, reason: Reason, detail: str) -> DropJob:
        """The same pair, given up."""
        return DropJob(self.source.label, self.target.label, reason, detail)


@dataclass(frozen=True)
class DropJob:
    """A pair, or a cloud without a partner, that gets a decision and no registration."""

    source: CloudLabel | None
    target: CloudLabel | None
    reason: Reason
    detail: str


@dataclass(frozen=True, eq=False)
class ScanWork:
    """What was computed of one cloud."""

    scan: Scan
    features: Features


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer to one job, with what its publishers may want to show."""

    result: RegistrationResult
    source: CloudLabel | None
    target: CloudLabel | None
    timings_ms: dict[str, float] = field(default_factory=dict)
    source_work: ScanWork | None = None
    target_work: ScanWork | None = None


Job = PairJob | DropJob


class JobQueue:
    """Jobs in order of arrival. At most `capacity` pairs wait: the oldest turns into a `superseded` drop in its place.

    A capacity of None bounds nothing. Safe for use from several threads.
    """

    def __init__(self) -> None:
        self._jobs: deque[Job] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, job: Job, capacity: int | None) -> None:
        """Append a job and make room."""
        with self._changed:
            self._jobs.append(job)
            waiting = [i for i, j in enumerate(self._jobs) if isinstance(j, PairJob)]
            surplus = 0 if capacity is None else len(waiting) - capacity
            for i in waiting[: max(surplus, 0)]:
                old = self._jobs[i]
                assert isinstance(old, PairJob)
                self._jobs[i] = old.drop(Reason.SUPERSEDED, "a newer pair came before this one was started")
            self._changed.notify()

    def get(self) -> Job | None:
        """Wait for the next job; None when the queue is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._jobs or self._closed)
            return None if self._closed else self._jobs.popleft()

    def give_up(self, reason: Reason, detail: str) -> None:
        """Turn every pair that waits into a drop."""
        with self._changed:
            self._jobs = deque(j.drop(reason, detail) if isinstance(j, PairJob) else j for j in self._jobs)

    def close(self) -> None:
        """Let `get` return None from now on."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def num_pairs(self) -> int:
        """Pairs that wait."""
        with self._changed:
            return sum(isinstance(job, PairJob) for job in self._jobs)


class Worker:
    """Runs `prepare` once and then `process` for every job, on a thread of its own.

    What `process` raises is logged, and the next job is processed.
    """

    def __init__(self, process: Callable[[Job], None], prepare: Callable[[], None]) -> None:
        self.jobs = JobQueue()
        self.ready = threading.Event()
        self._process, self._prepare = process, prepare
        self._thread = threading.Thread(target=self._run, name="registration", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self, timeout_s: float) -> bool:
        """Let the thread end after its current job; False if that takes longer than `timeout_s`."""
        self.jobs.close()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._guarded(self._prepare)
        self.ready.set()
        while (job := self.jobs.get()) is not None:
            self._guarded(self._process, job)

    def _guarded(self, call: Callable[..., None], *args: Any) -> None:
        try:
            call(*args)
        except Exception:
            _log.exception("%s failed", getattr(call, "__qualname__", call))


class PairRegistrar:
    """Turns jobs into decisions, and reuses the features of a cloud that comes again.

    origin_of: where the sensor stood in the frame of a cloud, (frame, stamp_ns) -> (3,) [m]; guess_of: a pose
    (4, 4) to try first for a source stamp, or None. Belongs to one thread.
    """

    def __init__(
        self, origin_of: Callable[[str, int], Array], guess_of: Callable[[int], Array | None] = lambda _stamp: None
    ) -> None:
        self._origin_of, self._guess_of = origin_of, guess_of
        self._cache: OrderedDict[tuple[Any, ...], ScanWork] = OrderedDict()
        self.num_reused = 0

    def decide(self, job: Job, config: Config) -> Decision:
        """The decision on one job; never raises."""
        if isinstance(job, DropJob):
            return Decision(dropped(job.reason, job.detail, config.method), job.source, job.target)
        start = time.monotonic()
        timings = {"queue_ms": 1e3 * (start - max(job.source.received_s, job.target.received_s))}
        works: list[ScanWork] = []
        try:
            works = [self._work("source", job.source, config), self._work("target", job.target, config)]
            timings["features_ms"] = 1e3 * (time.monotonic() - start)
            result = self._register(works[0].features, works[1].features, job.source.stamp_ns, config)
        except Exception as error:
            result = refused(error, config)
        timings["latency_ms"] = 1e3 * (time.monotonic() - max(job.source.received_s, job.target.received_s))
        return Decision(result, job.source.label, job.target.label, timings, *works)

    def forget(self) -> None:
        """Drop the cached features."""
        self._cache.clear()

    def _register(self, source: Features, target: Features, stamp_ns: int, config: Config) -> RegistrationResult:
        guess = self._guess_of(stamp_ns)
        if guess is not None:
            verified = verify(source, target, guess, config)
            if verified.accepted:
                return verified
        return register_pair(source, target, config)

    def _work(self, side: str, cloud: Cloud, config: Config) -> ScanWork:
        try:
            origin = self._origin_of(str(cloud.message.header.frame_id), cloud.stamp_ns)
            key = (_fingerprint(cloud.message), tuple(origin.tolist()), config)
            if key in self._cache:
                self.num_reused += 1
                self._cache.move_to_end(key)
                return self._cache[key]
            scan = scan_from_cloud(cloud.message, sensor_origin=origin).scan
            work = ScanWork(scan, extract_features(scan, config))
        except InputError as error:
            raise type(error)(f"{side}: {error}") from error
        self._cache[key] = work
        while len(self._cache) > _CACHED_SCANS:
            self._cache.popitem(last=False)
        return work


def warm_up(config: Config) -> None:
    """Register a small made-up scene, so that everything is imported and compiled before the first real pair."""
    v = config.preprocess.voxel_size_m
    rng = np.random.default_rng(0)
    across = rng.uniform(-1, 1, (6000, 3)) * 40 * v
    across[:3000, 2] = -8 * v + np.sin(across[:3000, 0] / (5 * v)) * np.cos(across[:3000, 1] / (7 * v)) * 3 * v
    across[3000:, 0] = 30 * v + np.sin(across[3000:, 1] / (4 * v)) * 3 * v
    scan = Scan(across)
    register_pair(scan, scan, config)


def _fingerprint(message: Any) -> bytes:
    """A name for what the cloud says, whatever its stamp: equal clouds have equal features."""
    layout = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    shape = (message.height, message.width, message.point_step, message.row_step, bool(message.is_bigendian))
    digest = hashlib.blake2b(repr((message.header.frame_id, layout, shape)).encode(), digest_size=16)
    digest.update(memoryview(message.data).cast("B"))
    return digest.digest()
