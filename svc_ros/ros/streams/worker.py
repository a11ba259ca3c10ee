"""One thread that computes, fed by a bounded queue; callbacks only put jobs in. Plain Python, no rclpy."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from svc_ros.core.result import Reason

_log = logging.getLogger(__name__)


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


@dataclass(frozen=True, eq=False)
class ScanJob:
    """A scan of a stream that waits for its turn."""

    cloud: Cloud

    def drop(self, reason: Reason, detail: str) -> DropJob:
        """The same scan, given up; a scan that was compared with nothing is its own target."""
        return DropJob(self.cloud.label, self.cloud.label, reason, detail)


@dataclass(frozen=True)
class DropJob:
    """A pair, a scan, or a cloud without a partner, that gets a decision and no computation."""

    source: CloudLabel | None
    target: CloudLabel | None
    reason: Reason
    detail: str


@dataclass(frozen=True, eq=False)
class CallJob:
    """Something to do between two jobs, on the worker's thread; it gets no decision."""

    call: Callable[[], None]


Job = PairJob | ScanJob | DropJob


class JobQueue:
    """Jobs in order of arrival. At most `capacity` of them wait to be computed: the oldest turns into a `superseded`
    drop in its place.

    A capacity of None bounds nothing. Safe for use from several threads.
    """

    def __init__(self) -> None:
        self._jobs: deque[Job | CallJob] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def put(self, job: Job, capacity: int | None) -> None:
        """Append a job and make room."""
        with self._changed:
            self._jobs.append(job)
            waiting = [i for i, j in enumerate(self._jobs) if isinstance(j, PairJob | ScanJob)]
            surplus = 0 if capacity is None else len(waiting) - capacity
            for i in waiting[: max(surplus, 0)]:
                old = self._jobs[i]
                assert isinstance(old, PairJob | ScanJob)
                self._jobs[i] = old.drop(Reason.SUPERSEDED, "a newer one came before this one was started")
            self._changed.notify()

    def call_next(self, call: Callable[[], None]) -> None:
        """Let the worker call this before all jobs that wait."""
        with self._changed:
            self._jobs.appendleft(CallJob(call))
            self._changed.notify()

    def get(self) -> Job | CallJob | None:
        """Wait for the next job; None when the queue is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._jobs or self._closed)
            return self._jobs.popleft() if self._jobs else None

    def give_up(self, reason: Reason, detail: str) -> None:
        """Turn everything that waits to be computed into a drop."""
        with self._changed:
            self._give_up(reason, detail)

    def close(self, detail: str) -> None:
        """Nothing is computed any more: what waits becomes an `inactive` drop, and calls are left out."""
        with self._changed:
            self._closed = True
            self._give_up(Reason.INACTIVE, detail)
            self._jobs = deque(job for job in self._jobs if not isinstance(job, CallJob))
            self._changed.notify_all()

    @property
    def num_waiting(self) -> int:
        """Pairs and scans that wait to be computed."""
        with self._changed:
            return sum(isinstance(job, PairJob | ScanJob) for job in self._jobs)

    def _give_up(self, reason: Reason, detail: str) -> None:
        given_up = (j.drop(reason, detail) if isinstance(j, PairJob | ScanJob) else j for j in self._jobs)
        self._jobs = deque(given_up)


class Worker:
    """Runs `prepare` once and then `process` for every job, on a thread of its own.

    What `process` or a call raises is logged, and the next job is processed.
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
        """Let the thread end after its current job and the drops; False if that takes longer than `timeout_s`."""
        self.jobs.close("the node was stopped")
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._guarded(self._prepare)
        self.ready.set()
        while (job := self.jobs.get()) is not None:
            if isinstance(job, CallJob):
                self._guarded(job.call)
            else:
                self._guarded(self._process, job)

    def _guarded(self, call: Callable[..., None], *args: Any) -> None:
        try:
            call(*args)
        except Exception:
            _log.exception("%s failed", getattr(call, "__qualname__", call))
