"""Items made in another thread: the same ones in the same order, and no thread that stays behind."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
from yardstick import PATIENCE_S

from svc_ros.replay.ahead import ahead


def threads_ahead() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "ahead"]


def test_the_same_items_in_the_same_order() -> None:
    assert list(ahead(iter(range(100)))) == list(range(100))
    assert list(ahead([])) == []
    assert list(ahead(ahead(k * k for k in range(10)))) == [k * k for k in range(10)]
    assert threads_ahead() == []


def test_items_are_made_elsewhere_and_at_most_so_many_before_they_are_asked_for() -> None:
    made: list[str] = []

    def items() -> Iterator[int]:
        for k in range(20):
            made.append(threading.current_thread().name)
            yield k

    found = ahead(items(), num=3)
    assert next(found) == 0
    deadline = time.monotonic() + PATIENCE_S
    while len(made) < 5 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.3)  # it could go on in that time, and does not
    assert made == ["ahead"] * 5  # one taken, three waiting, one in the maker's hand
    found.close()
    assert threads_ahead() == []


def test_an_exception_comes_where_its_item_would_have_come() -> None:
    def items() -> Iterator[int]:
        yield 1
        yield 2
        raise ValueError("the bag ends here")

    found = ahead(items())
    assert (next(found), next(found)) == (1, 2)
    with pytest.raises(ValueError, match="ends here"):
        next(found)
    assert threads_ahead() == []


def test_closing_early_gives_back_what_the_items_hold() -> None:
    closed: list[str] = []

    def items() -> Iterator[int]:
        try:
            yield from range(1000)
        finally:
            closed.append(threading.current_thread().name)

    found = ahead(ahead(items()))
    assert next(found) == 0
    found.close()
    assert closed == ["ahead"]
    assert threads_ahead() == []
