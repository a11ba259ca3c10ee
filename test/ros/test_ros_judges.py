"""Threads that judge: the order of what they tell, what gives way, and what waits; without a node."""

from __future__ import annotations

import random
import threading
import time

import numpy as np
import pytest
from plain_clouds import small_pair
from yardstick import PATIENCE_S

from svc_ros.core.config import preset
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.ros.streams.decision import Decision, Judgement, labels
from svc_ros.ros.streams.judges import Judges

CONFIG = preset("lidar_indoor")


class Bench:
    """Judges, what they have told, and judgements that last until they are let go."""

    def __init__(self, num_threads: int) -> None:
        self.told: list[tuple[int, str]] = []
        self.changed = threading.Condition()
        self.begun: list[int] = []
        self.may_end = threading.Event()
        self.judges = Judges(self._tell, num_threads)

    def _tell(self, decisions: list[Decision]) -> None:
        with self.changed:
            self.told += [(d.source.stamp_ns, d.result.reason.value) for d in decisions]
            self.changed.notify_all()

    def put(self, stamp_ns: int, capacity: int = 100, every: bool = False) -> None:
        """A judgement that lasts until it may end."""
        job = small_pair(stamp_ns)

        def judge() -> list[Decision]:
            with self.changed:
                self.begun.append(stamp_ns)
                self.changed.notify_all()
            assert self.may_end.wait(PATIENCE_S)
            return [accepted(job)]

        self.judges.put(Judgement(job, CONFIG, judge), capacity, every)

    def fill(self, num_more: int) -> int:
        """Judgements for all threads, which are begun then, and some more that wait; returns how many are begun."""
        num_threads = self.judges._num_threads
        for stamp_ns in range(num_threads + num_more):
            self.put(stamp_ns)
        self.until(lambda: len(self.begun) == num_threads)
        return num_threads

    def until(self, is_so) -> None:
        with self.changed:
            assert self.changed.wait_for(is_so, PATIENCE_S)

    def end(self) -> None:
        self.may_end.set()
        self.judges.wait()
        self.judges.close("the test is over")
        assert self.judges.join(PATIENCE_S)


def accepted(job) -> Decision:
    return Decision(RegistrationResult(Verdict.ACCEPTED, Reason.OK, T_target_source=np.eye(4)), *labels(job))


@pytest.fixture(params=[1, 4])
def bench(request):
    bench = Bench(request.param)
    yield bench
    bench.may_end.set()
    bench.judges.close("the test is over")


def test_with_every_one_decisions_are_told_in_the_order_of_their_jobs_whoever_is_quickest() -> None:
    told, rng = [], random.Random(0)
    judges = Judges(lambda decisions: told.append([d.source.stamp_ns for d in decisions]), num_threads=4)
    for stamp_ns in range(60):
        job, seconds = small_pair(stamp_ns), rng.choice([0.0, 0.001, 0.01])

        def judge(job=job, seconds=seconds) -> list[Decision]:
            time.sleep(seconds)
            return [accepted(job)] * 2

        judges.put([accepted(job)] * 2 if stamp_ns % 3 == 0 else Judgement(job, CONFIG, judge), 100, every=True)
    judges.wait()
    assert told == [[stamp_ns] * 2 for stamp_ns in range(60)]
    judges.close("the test is over")
    assert judges.join(PATIENCE_S)


def test_several_are_judged_at_once() -> None:
    bench = Bench(num_threads=3)
    for stamp_ns in range(5):
        bench.put(stamp_ns)
    bench.until(lambda: len(bench.begun) == 3)
    assert bench.judges.num_waiting == 2
    bench.end()
    assert sorted(bench.told) == [(stamp_ns, "ok") for stamp_ns in range(5)]


def test_live_a_hard_candidate_keeps_no_easy_one_waiting() -> None:
    bench = Bench(num_threads=2)
    bench.put(0)
    bench.until(lambda: bench.begun == [0])
    for stamp_ns in (1, 2, 3):
        job = small_pair(stamp_ns)
        easy = [accepted(job)] if stamp_ns == 2 else Judgement(job, CONFIG, lambda job=job: [accepted(job)])
        bench.judges.put(easy, 100, every=False)
    bench.until(lambda: len(bench.told) == 3)
    assert sorted(bench.told) == [(1, "ok"), (2, "ok"), (3, "ok")]
    bench.end()
    assert bench.told[-1] == (0, "ok")


def test_the_oldest_that_waits_is_superseded() -> None:
    bench = Bench(num_threads=1)
    bench.put(0)
    bench.until(lambda: bench.begun == [0])
    for stamp_ns in (1, 2, 3, 4):
        bench.put(stamp_ns, capacity=2)
    assert bench.judges.num_waiting == 2
    bench.end()
    assert bench.told == [(1, "superseded"), (2, "superseded"), (0, "ok"), (3, "ok"), (4, "ok")]


def test_where_nothing_may_be_lost_the_worker_waits_for_room() -> None:
    bench = Bench(num_threads=1)
    bench.put(0, every=True)
    bench.until(lambda: bench.begun == [0])
    bench.put(1, capacity=1, every=True)
    worker = threading.Thread(target=lambda: bench.put(2, capacity=1, every=True))
    worker.start()
    worker.join(0.2)
    assert worker.is_alive()
    bench.may_end.set()
    worker.join(PATIENCE_S)
    bench.end()
    assert bench.told == [(0, "ok"), (1, "ok"), (2, "ok")]


def test_giving_up_while_judging_keeps_what_is_being_judged(bench) -> None:
    num_threads = bench.fill(2)
    bench.judges.give_up(Reason.STALE, "the node was reset")
    assert bench.judges.num_waiting == 0
    bench.put(99)
    bench.end()
    begun = [(stamp_ns, "ok") for stamp_ns in range(num_threads)]
    assert sorted(bench.told) == [*begun, (num_threads, "stale"), (num_threads + 1, "stale"), (99, "ok")]


def test_what_is_given_up_is_told_although_nothing_else_comes(bench) -> None:
    num_threads = bench.fill(1)
    bench.judges.give_up(Reason.INACTIVE, "the node was disabled")
    bench.may_end.set()
    bench.until(lambda: len(bench.told) == num_threads + 1)
    assert (num_threads, "inactive") in bench.told


def test_closed_judges_answer_all_that_waits_and_comes(bench) -> None:
    num_threads = bench.fill(1)
    bench.judges.close("the node was stopped")
    bench.put(99, capacity=1, every=True)
    assert bench.judges.join(0.1) is False
    bench.may_end.set()
    assert bench.judges.join(PATIENCE_S)
    begun = [(stamp_ns, "ok") for stamp_ns in range(num_threads)]
    assert sorted(bench.told) == [*begun, (num_threads, "inactive"), (99, "inactive")]


@pytest.mark.parametrize("every", [True, False])
def test_what_is_closed_is_answered_although_all_judges_are_busy(bench, every) -> None:
    for stamp_ns in range(1, 8):
        bench.put(stamp_ns, every=every)
    bench.until(lambda: len(bench.begun) in (1, 4) and bench.judges.num_waiting == 7 - len(bench.begun))
    bench.judges.close("the node was stopped")
    assert not bench.judges.join(0.0)
    assert sorted(bench.told) == [(k, "inactive") for k in range(len(bench.begun) + 1, 8)]


def test_closing_ends_the_waiting_for_room() -> None:
    bench = Bench(num_threads=1)
    bench.put(0)
    bench.until(lambda: bench.begun == [0])
    bench.put(1)
    worker = threading.Thread(target=lambda: bench.put(2, capacity=1, every=True))
    worker.start()
    bench.judges.close("the node was stopped")
    worker.join(PATIENCE_S)
    assert not worker.is_alive()
    bench.may_end.set()
    assert bench.judges.join(PATIENCE_S)
    assert sorted(bench.told) == [(0, "ok"), (1, "inactive"), (2, "inactive")]


def test_what_goes_wrong_is_a_decision_and_the_next_one_is_judged(bench) -> None:
    def fail() -> list[Decision]:
        raise RuntimeError("boom")

    bench.may_end.set()
    bench.judges.put(Judgement(small_pair(1), CONFIG, fail), 10, every=False)
    bench.put(2)
    bench.end()
    assert sorted(bench.told) == [(1, "internal_error"), (2, "ok")]


def test_what_cannot_be_told_does_not_keep_the_rest(caplog) -> None:
    told = []

    def tell(decisions: list[Decision]) -> None:
        if decisions[0].source.stamp_ns == 1:
            raise RuntimeError("nobody listens")
        told.append(decisions[0].source.stamp_ns)

    judges = Judges(tell, num_threads=2)
    for stamp_ns in (1, 2):
        judges.put([accepted(small_pair(stamp_ns))], 1, every=False)
    judges.wait()
    assert told == [2]
    assert "nobody listens" in caplog.text


def test_without_anything_to_judge_there_are_no_threads() -> None:
    judges = Judges(lambda decisions: None)
    judges.put([accepted(small_pair(1))], 1, every=False)
    judges.put([], 1, every=False)
    assert judges._threads == []
    judges.close("the test is over")
    assert judges.join(0.0)
