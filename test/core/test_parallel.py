"""Work on several threads: results in order, errors raised, threads used."""

from __future__ import annotations

import os
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
from yardstick import PATIENCE_S

from svc_ros.core import parallel


@pytest.mark.parametrize("num_processors", [1, 4])
def test_results_are_in_order(monkeypatch, num_processors):
    monkeypatch.setattr(parallel, "num_processors", lambda: num_processors)
    assert parallel.on_all_processors(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert parallel.on_all_processors(lambda n: n, []) == []


def test_two_parts_run_at_the_same_time(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 2)
    both = threading.Barrier(2, timeout=PATIENCE_S)
    assert sorted(parallel.on_all_processors(lambda _: both.wait(), range(2))) == [0, 1]


def test_one_processor_starts_no_thread(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 1)
    assert parallel.on_all_processors(lambda _: threading.get_ident(), range(3)) == [threading.get_ident()] * 3


def test_errors_come_out():
    with pytest.raises(ZeroDivisionError):
        parallel.on_all_processors(lambda n: 1 // n, [1, 0, 1])


def test_an_error_ends_the_call_for_all(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 2)
    done = []

    def work(n: int) -> None:
        if n == 3:
            raise ValueError("three")
        done.append(n)

    with pytest.raises(ValueError, match="three"):
        parallel.on_all_processors(work, range(10_000))
    assert len(done) < 10_000


def test_calls_inside_calls_and_beside_each_other_all_end(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 2)

    def inner(n: int) -> list[int]:
        return parallel.on_all_processors(lambda k: n + k, range(5))

    def outer() -> list[list[int]]:
        return parallel.on_all_processors(inner, range(50))

    expected = [[n + k for k in range(5)] for n in range(50)]
    with ThreadPoolExecutor(4) as callers:
        calls = [callers.submit(outer) for _ in range(8)]
        assert all(call.result(timeout=PATIENCE_S) == expected for call in calls)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork a process")
def test_a_forked_process_has_threads_of_its_own(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 2)
    parallel.on_all_processors(lambda n: n, range(4))  # the threads are there now
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # forking with threads is what is looked at
        child = os.fork()
    if child == 0:
        both = threading.Barrier(2, timeout=PATIENCE_S)
        os._exit(0 if sorted(parallel.on_all_processors(lambda _: both.wait(), range(2))) == [0, 1] else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_there_is_a_processor():
    assert parallel.num_processors() >= 1
