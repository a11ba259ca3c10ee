"""Work on several threads: results in order, errors raised, threads used."""

from __future__ import annotations

import threading

import pytest

from svc_ros.core import parallel


@pytest.mark.parametrize("num_processors", [1, 4])
def test_results_are_in_order(monkeypatch, num_processors):
    monkeypatch.setattr(parallel, "num_processors", lambda: num_processors)
    assert parallel.on_all_processors(lambda n: n * n, range(20)) == [n * n for n in range(20)]
    assert parallel.on_all_processors(lambda n: n, []) == []


def test_two_parts_run_at_the_same_time(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 2)
    both = threading.Barrier(2, timeout=10)
    assert sorted(parallel.on_all_processors(lambda _: both.wait(), range(2))) == [0, 1]


def test_one_processor_starts_no_thread(monkeypatch):
    monkeypatch.setattr(parallel, "num_processors", lambda: 1)
    assert parallel.on_all_processors(lambda _: threading.get_ident(), range(3)) == [threading.get_ident()] * 3


def test_errors_come_out():
    with pytest.raises(ZeroDivisionError):
        parallel.on_all_processors(lambda n: 1 // n, [1, 0, 1])


def test_there_is_a_processor():
    assert parallel.num_processors() >= 1
