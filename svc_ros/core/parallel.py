"""All processors for one job, by threads: the compiled kernels hold no GIL."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_PART = 1024

Part = TypeVar("Part")
Done = TypeVar("Done")


def on_all_processors(work: Callable[[Part], Done], parts: Iterable[Part]) -> list[Done]:
    """Do the work for every part, on as many threads as this process has processors; results in order.

    An exception of any part is raised. The threads end with the call.
    """
    parts = list(parts)
    num_threads = min(len(parts), num_processors())
    if num_threads <= 1:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(num_threads) as threads:
        return list(threads.map(work, parts))


def in_parts(num: int, part: int = _PART) -> list[slice]:
    """0..num-1 in parts so small that no processor waits long for the others. The last may be shorter."""
    return [slice(start, min(start + part, num)) for start in range(0, num, part)]


def num_processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
