"""A Dask scheduler and workers as processes of their own, and things for them to do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from places import PROJECT_ROOT, SUPPORT

_PATIENCE_S = 40.0


@dataclass
class Cluster:
    """A scheduler's address and its workers' processes."""

    address: str
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)


@contextmanager
def cluster(folder: Path, num_workers: int = 2, threads: int = 1) -> Iterator[Cluster]:
    """Started, and ended when left. Workers have no nanny: one that is killed stays away."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(module: str, *options: str) -> subprocess.Popen[bytes]:
        path = os.pathsep.join([str(SUPPORT), str(PROJECT_ROOT), os.environ.get("PYTHONPATH", "")])
        with (folder / f"{len(processes)}.log").open("wb") as log:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *options]
            environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
            processes.append(subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log))
        return processes[-1]

    try:
        file = folder / "scheduler.json"
        start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        found = Cluster(_address(file))
        options = ("--nthreads", str(threads), "--no-nanny", "--no-dashboard", "--local-directory", str(folder))
        found.workers += [start("dask_worker", found.address, *options) for _ in range(num_workers)]
        yield found
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


def _address(file: Path) -> str:
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):
            time.sleep(0.05)
    raise TimeoutError(f"{file}: the scheduler did not start")


def double(number: int) -> int:
    """Twice the number."""
    return 2 * number


def double_slowly(number: int) -> tuple[int, int]:
    """Twice the number, and the process that found it."""
    time.sleep(0.1)
    return 2 * number, os.getpid()


def refuse_some(number: int) -> int:
    """Numbers from 3 on are refused; larger ones sooner."""
    if number >= 3:
        time.sleep(0.6 if number == 3 else 0.0)
        raise ValueError(f"number {number}")
    return number


def die(number: int) -> int:
    """Takes its process down on 1."""
    if number == 1:
        os._exit(1)
    return number


def count_threads(_: int) -> set[int]:
    """How many processors the modules of the core believe to have in this process."""
    return {
        module.num_processors()
        for name, module in list(sys.modules.items())
        if name.startswith("svc_ros.core.") and hasattr(module, "num_processors")
    }


def interrupt_is_ignored(_: int) -> bool:
    """Whether Ctrl-C is nothing to this process."""
    return signal.getsignal(signal.SIGINT) == signal.SIG_IGN
