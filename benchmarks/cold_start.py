"""How long until it answers? The command line's help, and the node's word that it is ready, each in a new process.

And what the very first start adds: how many kernels it compiles, and the processor's time for them.

    python benchmarks/cold_start.py [--rounds N] [--out DIR]

Else compiled kernels are in their cache: everything is started once before it is timed. Writes the section `cold_start`
of latest.json.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import PROJECT_ROOT, console, describe_run, parse_options
from lib.latest import record

from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id

HELP = [sys.executable, "-m", "svc_ros", "register", "--help"]
COMPILE = [sys.executable, "-m", "svc_ros.ros.compile_kernels"]
READY, GIVE_UP_S = "ready:", 120.0


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--rounds", type=int, default=3, help="timed starts of each program")

    options = parse_options("Time from start to answer.", extend, workers=False)
    run = describe_run([])
    values: dict[str, Any] = {"rounds": options.rounds}
    values["register_help_s"] = repeat(start_help, options.rounds)
    has_ros = importlib.util.find_spec("rclpy") is not None
    values["node_ready_s"] = repeat(start_node, options.rounds) if has_ros else None
    values |= compile_all()
    for name, value in values.items():
        console.print(f"cold_start.{name} = {value if value is None else f'{value:.3g}'}")
    record(options.out, "cold_start", run, {"cold_start": values})


def repeat(start: Callable[[], float], rounds: int) -> float:
    """Median seconds; the first start fills the caches and does not count."""
    start()
    return float(np.median([start() for _ in range(rounds)]))


def start_help() -> float:
    """Seconds that `svc_ros register --help` takes."""
    begin = time.perf_counter()
    subprocess.run(HELP, cwd=PROJECT_ROOT, capture_output=True, check=True)
    return time.perf_counter() - begin


def compile_all() -> dict[str, float]:
    """Kernels that a start with an empty cache compiles, and seconds of a processor that it takes over one with all."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        seconds, told = [], []
        for _ in range(2):
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            done = subprocess.run(
                COMPILE, cwd=PROJECT_ROOT, env=environment, stderr=subprocess.PIPE, text=True, check=True
            )
            seconds.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
            told.append(re.findall(r"^compiled (\d+) kernels", done.stderr, re.MULTILINE))
    if len(told[0]) != 1 or told[1]:
        sys.exit(f"expected the first start to compile and the second not to, found {told}")
    return {"compiled_kernels": int(told[0][0]), "compile_cpu_s": seconds[0] - seconds[1]}


def start_node() -> float:
    """Seconds until the node says that it is ready."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        with ChildProcess("svc_ros.ros.node", [], local_environment(own_domain_id()), Path(folder) / "log") as node:
            while READY not in node.output():
                if node.exit_code is not None or time.perf_counter() - begin > GIVE_UP_S:
                    sys.exit(f"the node was not ready after {time.perf_counter() - begin:.0f} s:\n{node.output()}")
                time.sleep(0.005)
            return time.perf_counter() - begin


if __name__ == "__main__":
    main()
