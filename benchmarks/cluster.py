"""Is an evaluation over several processes or machines the same as a serial one, also when a worker is killed?

    python benchmarks/cluster.py [--sets NAME ...] [--limit N] [--data DIR] [--out DIR]

The same evaluation of several sets four times: serially, over processes, over a Dask cluster of this machine, and over
a scheduler with two workers in processes of their own, one of which is killed in the middle. Ends with an error if any
report differs, times aside. Writes cluster.json.
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from lib.common import PROJECT_ROOT, config_of, console, describe_run, parse_options, print_table, write_report
from lib.paper import other_sets

from svc_ros.evaluation.distributed import LOCAL, run_over
from svc_ros.evaluation.runner import evaluate_datasets

SETS = ("os1_64_seosan", "hdl64_kitti_a", "rgbd_redkitchen", "os0_64_walk")
_PATIENCE_S = 60.0
Report = list[dict[str, Any]]


class DifferentReportError(RuntimeError):
    """A spread evaluation says something else than the serial one."""


def main() -> None:
    """Run four times, compare, write."""
    options = parse_options("Evaluation over workers, compared with the serial run.", extend, workers=False)
    datasets = other_sets(options.data, options.sets)
    run = describe_run(datasets)
    evaluate = partial(evaluate_datasets, [(dataset, config_of(dataset)) for dataset in datasets], options.limit)
    serial, serial_s = timed(evaluate, 1)
    rows = [("serial", serial_s, None)]
    for name, workers in (("processes", 2), ("dask, local", partial(run_over, LOCAL))):
        report, seconds = timed(evaluate, workers)
        require_same(name, serial, report)
        rows.append((name, seconds, None))
    with cluster() as (address, victim):
        killed: list[int] = []
        report, seconds = timed(evaluate, partial(run_over, address), lambda *now: kill_once(victim, killed, *now))
        require_same("dask, a worker killed", serial, report)
        rows.append(("dask, a worker killed", seconds, killed[0]))
    print_table("the same report each time", ("run", "seconds", "jobs done when a worker was killed"), rows)
    compared = {d.name: counts(r) for d, r in zip(datasets, serial, strict=True)}
    runs = [dict(zip(("run", "time_s", "killed_after"), row, strict=True)) for row in rows]
    values = {"sets": compared, "limit": options.limit, "same_report": True, "runs": runs}
    write_report(options.out / "cluster.json", values, run)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--sets", nargs="+", default=SETS, metavar="NAME", help="data sets")
    parser.add_argument("--limit", type=int, default=6, metavar="N", help="pairs and labelled pairs of each set")


def timed(evaluate: Callable[..., Report], *arguments: Any) -> tuple[Report, float]:
    """Reports, and the seconds they took."""
    start = time.perf_counter()
    return evaluate(*arguments), time.perf_counter() - start


def kill_once(victim: subprocess.Popen[bytes], killed: list[int], done: int, total: int) -> None:
    """End a worker when a third is done, with no warning."""
    if not killed and 3 * done >= total:
        os.kill(victim.pid, signal.SIGKILL)
        victim.wait()
        killed.append(done)


def require_same(name: str, serial: Report, other: Report) -> None:
    """Raise DifferentReportError unless both say the same, times aside."""
    for expected, found in zip(without_times(serial), without_times(other), strict=True):
        if json.dumps(expected, sort_keys=True) != json.dumps(found, sort_keys=True):
            keys = [key for key in expected if expected[key] != found.get(key)]
            raise DifferentReportError(f"{name}: {expected['dataset']} differs from the serial run: {', '.join(keys)}")
    console.print(f"{name}: same as serial")


def without_times(reports: Report) -> Report:
    """The reports without what differs from run to run."""
    reports = copy.deepcopy(reports)
    for report in reports:
        del report["time_ms"]
        for section in (report["registration"], report["negatives"] or {"pairs": []}):
            for row in section["pairs"]:
                del row["time_ms"]
    return reports


def counts(report: Mapping[str, Any]) -> dict[str, Any]:
    """What was compared."""
    decision = report["decision"] or {}
    poses = sum(decision.get(name, 0) for name in ("num_correct", "num_wrong"))
    return {"num_pairs": report["registration"]["num_pairs"], "num_labelled_poses": poses}


@contextmanager
def cluster() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler's address, and one of its two workers; nobody restarts a worker that is killed."""
    processes: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "scheduler.json"
        try:
            options = ("--port", "0", "--no-dashboard", "--scheduler-file", str(file))
            processes.append(start(folder, "dask_scheduler", *options))
            address = wait_for(file)
            options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder))
            processes += [start(folder, "dask_worker", address, *options) for _ in range(2)]
            yield address, processes[-1]
        finally:
            for process in processes:
                process.kill()
                process.wait()


def start(folder: Path, module: str, *options: str) -> subprocess.Popen[bytes]:
    """A process of Dask; it finds this checkout."""
    path = os.pathsep.join([str(PROJECT_ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    with (folder / "log").open("ab") as log:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--host", "127.0.0.1", *options]
        return subprocess.Popen(command, env=environment, stdout=log, stderr=log)


def wait_for(file: Path) -> str:
    """The address that a scheduler writes when it is ready."""
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):
            time.sleep(0.1)
    raise TimeoutError(f"{file}: no scheduler after {_PATIENCE_S:.0f} s")


if __name__ == "__main__":
    main()
