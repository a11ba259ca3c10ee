"""How much of a process' time other programs had, told by a process of its own.

Reading it takes a hundred calls to the system. In the process that is measured, its threads would wait for Python's
lock as often, and wait for each other more than for anything else.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time

import numpy as np
from yardstick import Stopwatch

_EVERY_S = 0.005


class OtherPrograms:
    """`with OtherPrograms() as others:` watches this process; afterwards `others.had_s(times)` tells by when how much.

    times: of `time.monotonic`, which is the same clock in all processes.
    """

    def __enter__(self) -> OtherPrograms:
        command = [sys.executable, __file__, str(os.getpid())]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it has begun
        return self

    def __exit__(self, *_exception: object) -> None:
        told, _ = self._process.communicate()  # it ends as its input is closed
        self._samples = np.array([[float(value) for value in line.split()] for line in told.splitlines()])

    def had_s(self, times: np.ndarray) -> np.ndarray:
        """Seconds that other programs had up to these times (N,), since the beginning."""
        return np.interp(times, *self._samples.T)


def _watch(pid: int) -> None:
    samples = []
    with Stopwatch(pid) as watch:
        print("begun", flush=True)
        while not select.select([sys.stdin], [], [], _EVERY_S)[0]:  # until it is closed
            watch.look()
            samples.append(f"{time.monotonic()} {watch.others_so_far_s}")
    print("\n".join(samples))


if __name__ == "__main__":
    _watch(int(sys.argv[1]))
