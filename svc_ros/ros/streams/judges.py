"""Threads that judge while the worker goes on: every candidate in order for bags, the newest as they are done live.

Plain Python, no rclpy.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from svc_ros.core.parallel import num_processors
from svc_ros.core.result import Reason
from svc_ros.ros.streams.decision import Decision, Judgement, Outcome, as_they_are

_log = logging.getLogger(__name__)
# Two where there is one processor to spare: a candidate that is hard takes fifty times as long as an easy one, which
# would wait for it. More than four would never have work, and each builds large search structures.
_LEAST_THREADS, _MOST_THREADS = 2, 4


@dataclass(eq=False)
class _Place:
    """One outcome in the line; a list of decisions is ready to be told, in turn or at once."""

    outcome: Outcome
    is_in_turn: bool
    is_begun: bool = False
    settle: Callable[[list[Decision]], list[Decision]] = as_they_are

    @property
    def is_waiting(self) -> bool:
        return isinstance(self.outcome, Judgement) and not self.is_begun

    def drop(self, reason: Reason, detail: str) -> None:
        assert isinstance(self.outcome, Judgement)
        self.outcome = self.outcome.drop(reason, detail)


class Judges:
    """Judges what is put in, several at once, and tells the decisions on each job.

    tell: gets the decisions of one job, by one thread at a time; what it raises is logged. num_threads: None for one
    less than there are processors, since one has to keep up with the scans, but from 2 to 4. They start with the first
    judgement.
    """

    def __init__(self, tell: Callable[[list[Decision]], None], num_threads: int | None = None) -> None:
        self._tell = tell
        self._num_threads = num_threads or min(max(num_processors() - 1, _LEAST_THREADS), _MOST_THREADS)
        self._line: deque[_Place] = deque()  # what is not told yet
        self._changed = threading.Condition()
        self._telling = threading.Lock()
        self._why_closed: str | None = None
        self._threads: list[threading.Thread] = []

    def put(self, outcome: Outcome, capacity: int, every: bool) -> None:
        """Take the next outcome. At most `capacity` judgements wait for a thread.

        every: where there is no room, wait for it, and tell the decisions after those of all that was put in before, so
        that they do not depend on who is quickest. Otherwise the oldest that waits is `superseded`, and decisions are
        told when they are made.
        """
        with self._changed:
            if every and isinstance(outcome, Judgement):
                self._changed.wait_for(lambda: self._why_closed is not None or len(self._waiting()) < capacity)
            self._line.append(_Place(outcome, every))
            if self._why_closed is not None:
                self._give_up(Reason.INACTIVE, self._why_closed)
            waiting = self._waiting()
            for place in waiting[: max(len(waiting) - capacity, 0)]:
                place.drop(Reason.SUPERSEDED, "newer ones came before its candidates could be judged")
            self._start_threads()
            self._changed.notify_all()
        self._tell_what_is_ready()

    def give_up(self, reason: Reason, detail: str) -> None:
        """Judge nothing that waits; what is being judged gets its decision."""
        with self._changed:
            self._give_up(reason, detail)
            self._changed.notify_all()

    def wait(self) -> None:
        """Return when everything that was put in is told."""
        with self._changed:
            self._changed.wait_for(lambda: not self._line)

    def close(self, detail: str) -> None:
        """Judge nothing more: what waits, and what comes, is `inactive`."""
        with self._changed:
            self._why_closed = detail
            self._give_up(Reason.INACTIVE, detail)
            self._changed.notify_all()

    def join(self, timeout_s: float) -> bool:
        """After `close`, tell what is not judged any more and wait for what is; False if that takes longer."""
        self._tell_what_is_ready()
        end = time.monotonic() + timeout_s
        for thread in self._threads:
            thread.join(max(end - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    @property
    def num_waiting(self) -> int:
        """Judgements that no thread has begun."""
        with self._changed:
            return len(self._waiting())

    # with `_changed` held

    def _waiting(self) -> list[_Place]:
        return [place for place in self._line if place.is_waiting]

    def _give_up(self, reason: Reason, detail: str) -> None:
        for place in self._waiting():
            place.drop(reason, detail)

    def _start_threads(self) -> None:
        if not self._threads and self._waiting():
            self._threads = [
                threading.Thread(target=self._run, name=f"judge_{k}", daemon=True) for k in range(self._num_threads)
            ]
            for thread in self._threads:
                thread.start()

    def _ready(self) -> tuple[_Place, list[Decision]] | None:
        for number, place in enumerate(self._line):
            is_its_turn = number == 0 or not place.is_in_turn or self._why_closed is not None
            if not isinstance(place.outcome, Judgement) and is_its_turn:
                return place, place.outcome
        return None

    def _has_work(self) -> bool:
        return self._ready() is not None or bool(self._waiting()) or self._why_closed is not None

    # on the threads

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(self._has_work)
                waiting = self._waiting()
                is_over = not waiting and self._why_closed is not None
                if waiting:
                    waiting[0].is_begun = True
                    self._changed.notify_all()  # there is room for another one
            if waiting:
                self._judge(waiting[0])
            self._tell_what_is_ready()
            if is_over:
                return

    def _judge(self, place: _Place) -> None:
        assert isinstance(place.outcome, Judgement)
        decisions, settle = place.outcome.decide(), place.outcome.settle
        with self._changed:
            place.outcome, place.settle = decisions, settle

    def _tell_what_is_ready(self) -> None:
        with self._telling:
            while (ready := self._next_to_tell()) is not None:
                place, decisions = ready
                try:
                    self._tell(place.settle(decisions))
                except Exception:
                    _log.exception("decisions could not be told")
                with self._changed:
                    self._line.remove(place)
                    self._changed.notify_all()

    def _next_to_tell(self) -> tuple[_Place, list[Decision]] | None:
        with self._changed:
            return self._ready()
