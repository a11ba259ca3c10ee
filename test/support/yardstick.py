"""Times on a busy machine: what a promise is measured against, and how long to wait for what comes at some time."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from svc_ros.ros.processes import ChildProcess

# Until a test gives up: no promise, only longer than anything takes on a busy machine that has to compile first.
PATIENCE_S = 300.0
_LOOK_S = 0.005


class Stopwatch:
    """`with Stopwatch() as watch:` measures the block; `watch.own_s` is what it takes where nothing else runs.

    Subtracted is how long threads of the process `pid` were ready to run and other programs had the processors: Linux
    counts that. On a quiet machine that is nothing, and so it is where the kernel does not tell.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._tasks = Path("/proc") / str(pid or os.getpid()) / "task"
        self._waited_ns: dict[str, int] = {}

    def __enter__(self) -> Stopwatch:
        self.look()
        self._waited_before_ns = sum(self._waited_ns.values())
        self._stolen_before_s, self._start = stolen_s(), time.monotonic()
        self.elapsed_s = self.others_s = 0.0
        return self

    def __exit__(self, *_exception: object) -> None:
        self.elapsed_s = time.monotonic() - self._start
        self.look()
        self.others_s = min(self.others_so_far_s, self.elapsed_s)

    @property
    def own_s(self) -> float:
        """Time of the block without that of other programs."""
        return self.elapsed_s - self.others_s

    @property
    def others_so_far_s(self) -> float:
        """What other programs have had since the beginning, up to the last look."""
        waited_ns = sum(self._waited_ns.values()) - self._waited_before_ns
        return 1e-9 * waited_ns + stolen_s() - self._stolen_before_s

    def look(self) -> None:
        """Read how long the threads have waited; what a thread has waited since the last look is lost when it ends."""
        with contextlib.suppress(OSError):
            for task in self._tasks.iterdir():
                with contextlib.suppress(OSError, IndexError):
                    self._waited_ns[task.name] = int((task / "schedstat").read_text().split()[1])

    def __str__(self) -> str:
        return f"{self.elapsed_s:.2f} s, of which other programs had {self.others_s:.2f} s"


def stolen_s() -> float:
    """What the machine under this one has taken from its processors so far, the mean over them; 0 if unknown."""
    with contextlib.suppress(OSError, IndexError):
        ticks = Path("/proc/stat").read_text().split("\n", 1)[0].split()[8]
        return int(ticks) / os.sysconf("SC_CLK_TCK") / (os.cpu_count() or 1)
    return 0.0


def time_to_end(pid: int, has_ended: Callable[[], bool], ask: Callable[[], None]) -> Stopwatch:
    """Ask a process to end, and wait until it has; what it was waiting for a processor is known to the last look."""
    with Stopwatch(pid) as watch:
        ask()
        end = time.monotonic() + PATIENCE_S
        while not has_ended() and time.monotonic() < end:
            watch.look()
            time.sleep(_LOOK_S)
    return watch


def assert_ends_within(promise_s: float, process: ChildProcess, signum: int = signal.SIGINT) -> None:
    """Send `signum` to a process; it has to end with exit code 0, in the time promised."""
    watch = time_to_end(process.pid, lambda: process.exit_code is not None, lambda: process.interrupt(signum))
    assert process.exit_code == 0, process.output()
    assert watch.own_s < promise_s, f"{watch}\n{process.output()}"
