"""What the benchmark scripts share: data sets, spreading work over processes, reports and tables."""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

PROJECT_ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(PROJECT_ROOT))  # the scripts run from a checkout, installed or not

from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from rich.table import Table  # noqa: E402

from svc_ros.core.config import Config, preset, with_values  # noqa: E402
from svc_ros.io.datasets import Dataset, read_dataset  # noqa: E402

DEFAULT_DATA = Path(os.environ.get("SVC_ROS_DATA", PROJECT_ROOT.parent / "shared" / "data")) / "pairs"
RESULTS = PROJECT_ROOT / "benchmarks" / "results"
SET_ORDER = (
    "os1_64_seosan", "hdl64_kitti_a", "hdl64_kitti_05_loop", "hdl32_easy", "rgbd_redkitchen", "os0_64_walk",
    "hdl64_kitti_negatives",
)  # fmt: skip
_PACKAGES = ("numpy", "scipy", "numba", "open3d-cpu", "small-gicp", "kiss-matcher")

console = Console(width=None if sys.stdout.isatty() else 150)
Item, Answer = TypeVar("Item"), TypeVar("Answer")


def parse_options(
    text: str, extend: Callable[[argparse.ArgumentParser], None] | None = None, workers: bool = True
) -> argparse.Namespace:
    """Options of every script: where the data are, where the results go, how many processes work (if several may)."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--data", type=Path, default=DEFAULT_DATA, help="folder of the data sets")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the JSON file and the picture")
    if workers:
        parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    if extend is not None:
        extend(parser)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def read_datasets(folder: Path) -> list[Dataset]:
    """All data sets of a folder, in the order of `SET_ORDER` and then by name; ends the script where there is none."""
    found = sorted(path.parent.name for path in folder.glob("*/dataset.json"))
    if not found:
        sys.exit(f"{folder}: expected folders with a dataset.json, found none (--data or SVC_ROS_DATA names the place)")
    known = [name for name in SET_ORDER if name in found]
    return [read_dataset(folder / name) for name in [*known, *(name for name in found if name not in known)]]


def config_of(dataset: Dataset, changes: Mapping[str, Any] | None = None) -> Config:
    """The preset of a data set within its range limits, with further values replaced."""
    limits = {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    return with_values(preset(dataset.preset), {**limits, **(changes or {})})


def spread(work: Callable[[Item], Answer], items: Sequence[Item], workers: int, text: str) -> list[Answer]:
    """The answers to all items, in order; a bar shows how far it is."""

    def shown(answers: Iterable[Answer]) -> list[Answer]:
        return list(track(answers, text, total=len(items), console=Console(stderr=True), transient=True))

    if workers < 2 or len(items) < 2:
        return shown(map(work, items))
    # one thread a process: threads that spin for each other's work would slow all processes down
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # spawned, not forked: a fork would copy the locks of numba's and Open3D's threads
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        return shown(pool.map(work, items))


def write_report(path: Path, values: Mapping[str, Any], run: Mapping[str, Any]) -> None:
    """Write a result with what it takes to make it again."""
    path.write_text(json.dumps({"run": run, **values}, indent=1, default=_plain) + "\n", encoding="utf-8")
    console.print(f"wrote {path}")


def describe_run(datasets: Sequence[Dataset]) -> dict[str, Any]:
    """Commit, machine, packages, date and the presets that the data sets use; asked for before the work begins.

    Range limits are not the preset's but the data set's own.
    """
    return {
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "commit": _git("rev-parse", "HEAD"),
        "uncommitted": _git("diff", "--name-only", "HEAD", "--", "svc_ros").split(),
        "machine": {"processor": _processor(), "cores": os.cpu_count(), "system": platform.platform(),
                    "python": platform.python_version()},
        "packages": dict(_versions()),
        "config": {name: dataclasses.asdict(preset(name)) for name in sorted({d.preset for d in datasets})},
    }  # fmt: skip


def child_environment(domain_id: int) -> dict[str, str]:
    """For a process on that domain: it finds the scripts and the package, installed or not."""
    from svc_ros.ros.processes import local_environment

    environment = local_environment(domain_id)
    paths = [str(PROJECT_ROOT / "benchmarks"), str(PROJECT_ROOT), environment.get("PYTHONPATH", "")]
    return {**environment, "PYTHONPATH": ":".join(path for path in paths if path)}


def print_table(title: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A table; the first column is text, the others are numbers, `-` where there is none."""
    table = Table(title=title, title_justify="left", title_style="bold")
    for k, name in enumerate(head):
        table.add_column(name, justify="right" if k else "left", no_wrap=k == 0)
    for row in rows:
        table.add_row(*(show(value) for value in row))
    console.print(table)


def show(value: Any) -> str:
    """Three decimals for shares, none for counts."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"
    return str(value)


def _git(*words: str) -> str:
    try:
        answer = subprocess.run(("git", *words), cwd=PROJECT_ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return answer.stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")


def _versions() -> Iterator[tuple[str, str]]:
    for name in _PACKAGES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
