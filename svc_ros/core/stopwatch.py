"""Wall time of the stages of one call."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Adds up milliseconds by stage name; `times()` closes with the total since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._stages: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block and add it to the stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._stages[name] = self._stages.get(name, 0.0) + 1e3 * (time.perf_counter() - start)

    def times(self) -> dict[str, float]:
        """Milliseconds by stage, and `total`."""
        return {**self._stages, "total": 1e3 * (time.perf_counter() - self._start)}
