"""All processors for one job, by threads: the compiled kernels hold no GIL."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache
from typing import Any, TypeVar

_PART = 1024
_limits: list[int] = [2**31]

Part = TypeVar("Part")
Done = TypeVar("Done")


def on_all_processors(work: Callable[[Part], Done], parts: Iterable[Part]) -> list[Done]:
    """Do the work for every part, on as many threads as this process has processors; results in order.

    The caller's thread works too, helped by threads that all calls of the process share: where they are busy, as in a
    call inside another one, it does all parts itself. An exception of any part ends the call and is raised.
    """
    parts = list(parts)
    num_helpers = min(len(parts), num_processors()) - 1
    if num_helpers <= 0:
        return [work(part) for part in parts]
    results: list[Any] = [None] * len(parts)
    unclaimed = itertools.count()
    failed: list[int] = []

    def work_along() -> None:
        while not failed and (k := next(unclaimed)) < len(parts):
            try:
                results[k] = work(parts[k])
            except BaseException:
                failed.append(k)
                raise

    helpers: list[Future[None]] = [_helpers().submit(work_along) for _ in range(num_helpers)]
    try:
        work_along()
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        errors = [error for helper in begun if (error := helper.exception()) is not None]
    if errors:
        raise errors[0]
    return results


@lru_cache(maxsize=1)
def _helpers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, num_processors() - 1), thread_name_prefix="svc_ros")


def in_parts(num: int, part: int = _PART) -> list[slice]:
    """0..num-1 in parts so small that no processor waits long for the others. The last may be shorter."""
    return [slice(start, min(start + part, num)) for start in range(0, num, part)]


def num_processors() -> int:
    """Threads that the kernels work on: the processors that this process may use, or fewer by `limit_threads`."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(available, *_limits)


def limit_threads(num_threads: int) -> None:
    """From now on the kernels of this process use at most so many threads; no result depends on it."""
    _limits[:] = [num_threads]


if hasattr(os, "register_at_fork"):  # a forked process has none of the threads
    os.register_at_fork(after_in_child=_helpers.cache_clear)
