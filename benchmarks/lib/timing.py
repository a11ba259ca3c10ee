"""Times of calls that take turns, and how they grow."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

_SHORT_MS = 20.0  # calls shorter than this are repeated inside one turn
Name = TypeVar("Name")


def time_in_turns(
    jobs: Mapping[Name, Callable[[], Any]], rounds: int, calls: int | None = None
) -> dict[Name, list[float]]:
    """Milliseconds a call of each job, one value a round.

    All jobs take turns, so that a slow minute of the machine hits all of them; each round begins with another one.
    Every job is called twice beforehand. calls: of each job in its turn; without it, short ones are repeated for a
    while. Where times of different lengths are set beside each other it should be given: then the first call, which
    finds little in the processor's caches, weighs the same in all of them.
    """
    for job in jobs.values():
        job()
    repeats = {name: calls or max(1, int(_SHORT_MS / max(_time_ms(job, 1), 1e-3))) for name, job in jobs.items()}
    names = list(jobs)
    times: dict[Name, list[float]] = {name: [] for name in names}
    for k in range(rounds):
        for name in rotated(names, k):
            times[name].append(_time_ms(jobs[name], repeats[name]))
    return times


def rotated(items: Sequence[Name], steps: int) -> list[Name]:
    """The items in order, another one first."""
    first = steps % max(len(items), 1)
    return [*items[first:], *items[:first]]


def medians(times: Mapping[Name, Sequence[float]]) -> dict[Name, float]:
    """The median of every job."""
    return {name: float(np.median(values)) for name, values in times.items()}


def exponent(numbers: Sequence[float], times: Sequence[float]) -> float:
    """Slope of log(time) over log(number): 1 where time is proportional to the number, 2 where to its square.

    ValueError for fewer than two numbers.
    """
    if len(set(numbers)) < 2:
        raise ValueError(f"expected at least two numbers to see how the time grows, found {list(numbers)}")
    return float(np.polyfit(np.log(numbers), np.log(times), 1)[0])


def time_once_ms(job: Callable[[], Any]) -> float:
    """Milliseconds of one call."""
    return _time_ms(job, 1)


def _time_ms(job: Callable[[], Any], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        job()
    return 1e3 * (time.perf_counter() - start) / repeats
