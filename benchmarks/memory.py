"""How much memory does the node need, and does it grow? Many pairs of full scans through its worker.

    python benchmarks/memory.py [--pairs N] [--seconds S] [--data DIR] [--out DIR]

Writes the section `memory` of latest.json, and memory.png. A pair is the last cloud and a new one, as in a drive;
every second pair comes with a guess, which is verified, the others are registered.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from lib.common import Dataset, config_of, console, describe_run, parse_options, read_datasets
from lib.figures import new_figure, write_figure
from lib.latest import record
from lib.resident import peak_mb, resident_mb

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.scan import Array
from svc_ros.io.clouds.point_cloud2 import cloud_layout
from svc_ros.ros.streams.registrar import PairRegistrar, warm_up
from svc_ros.ros.streams.worker import Cloud, Job, PairJob, Worker

SET = "hdl64_kitti_a"
MIDDLEWARE = "svc_ros.ros.registration_node"  # its libraries are part of what the node needs
WARM_UP_SHARE, MAX_WARM_UP = 0.4, 200  # the allocator takes so long to settle


@dataclass(eq=False)
class Drive:
    """Clouds one after the other: the set's scans in turn, each time turned by another angle about the sensor.

    So every cloud is new, as in a real drive, and the pose between two of them is known.
    """

    scans: Sequence[Array]
    poses: Sequence[Array]
    _turns: dict[int, Array] = field(default_factory=dict)

    def cloud(self, stamp: int) -> Cloud:
        """Cloud number `stamp`."""
        points = se3.apply(self._turn(stamp), self.scans[stamp % len(self.scans)]).astype(np.float32)
        return Cloud(message_of(points), stamp, time.monotonic())

    def guess(self, stamp: int) -> Array | None:
        """Pose of a cloud in the frame of the one before it, for every second cloud."""
        if stamp % 2 == 0:
            return None
        before, own = (self.poses[k % len(self.poses)] @ se3.invert(self._turn(k)) for k in (stamp - 1, stamp))
        return se3.nearest_pose(se3.invert(before) @ own)

    def _turn(self, stamp: int) -> Array:
        angle = 0.37 * stamp
        c, s = np.cos(angle), np.sin(angle)
        return se3.make_pose([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], (0.0, 0.0, 0.0))


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--pairs", type=int, default=2000, help="pairs at most")
        parser.add_argument("--seconds", type=float, default=75.0, help="time after which no pair is begun; 0: no end")

    options = parse_options("Memory of the node's worker over many pairs.", extend, workers=False)
    datasets = read_datasets(options.data)
    dataset = next((d for d in datasets if d.name == SET), datasets[0])
    run = describe_run([dataset])
    with_middleware = load_middleware()
    drive = read_drive(dataset)
    samples, verdicts = measure(drive, config_of(dataset), options.pairs, options.seconds or np.inf)
    values = {
        **fit(samples), "verdicts": verdicts, "points": int(np.median([len(scan) for scan in drive.scans])),
        "with_middleware": with_middleware, "dataset": dataset.name,
    }  # fmt: skip
    for name in ("pairs", "resident_mb", "peak_mb", "slope_mb_per_1000_pairs"):
        console.print(f"memory.{name} = {values[name]:.5g}")
    draw(samples, options.out / "memory.png")
    record(options.out, "memory", run, {"memory": values})


def read_drive(dataset: Dataset) -> Drive:
    """The scans of a set that lie on a chain of reference poses, in the order in which they follow each other."""
    placed = place_all(dataset)
    names = sorted(placed)
    there_and_back = [*names, *reversed(names[1:-1])]
    scans = {name: dataset.read_scan(name).points for name in names}
    return Drive([scans[name] for name in there_and_back], [placed[name] for name in there_and_back])


def place_all(dataset: Dataset) -> dict[str, Array]:
    """Poses (4, 4) in the frame of the first target, of every scan that pairs connect with it."""
    placed = {dataset.pairs[0].target: np.eye(4)}
    for _, pair in itertools.product(range(len(dataset.pairs)), dataset.pairs):
        T = pair.T_target_source
        if T is None:
            continue
        if pair.target in placed and pair.source not in placed:
            placed[pair.source] = placed[pair.target] @ T
        elif pair.source in placed and pair.target not in placed:
            placed[pair.target] = placed[pair.source] @ se3.invert(T)
    return placed


def measure(drive: Drive, config: Config, num_pairs: int, seconds: float) -> tuple[Array, dict[str, int]]:
    """Resident set [MB] before the first and after every pair, and how often each verdict was given."""
    registrar = PairRegistrar(lambda _frame, _stamp: np.zeros(3), drive.guess)
    samples: list[float] = []
    verdicts: dict[str, int] = {}

    def process(job: Job) -> None:
        try:
            verdict = registrar.decide(job, config).result.verdict.value
            verdicts[verdict] = verdicts.get(verdict, 0) + 1
        finally:
            samples.append(resident_mb())

    worker = Worker(process, lambda: warm_up(config))
    worker.start()
    worker.ready.wait()
    samples.append(resident_mb())
    end = time.monotonic() + seconds
    for number, job in enumerate(jobs(drive, num_pairs), 1):
        worker.jobs.put(job, None)
        while len(samples) <= number:
            time.sleep(0.001)
        if time.monotonic() > end:
            break
    worker.stop(5.0)
    return np.array(samples), verdicts


def jobs(drive: Drive, num_pairs: int) -> Iterator[PairJob]:
    """Each cloud with the one before it."""
    target = drive.cloud(0)
    for stamp in range(1, num_pairs + 1):
        source = drive.cloud(stamp)
        yield PairJob(source, target)
        target = source


def fit(samples: Array) -> dict[str, Any]:
    """Resident set after the last pair and at most, and the slope of a straight line through it after the warm-up."""
    num = len(samples) - 1
    warm_up_pairs = min(int(WARM_UP_SHARE * num), MAX_WARM_UP)
    later = samples[1 + warm_up_pairs :]
    slope = float(np.polyfit(np.arange(len(later)), later, 1)[0]) if len(later) > 1 else float("nan")
    return {
        "pairs": num, "warm_up_pairs": warm_up_pairs, "before_mb": float(samples[0]),
        "resident_mb": float(samples[-1]), "peak_mb": peak_mb(), "slope_mb_per_1000_pairs": 1000.0 * slope,
        "spread_mb": float(np.ptp(later)),
    }  # fmt: skip


def load_middleware() -> bool:
    """Load what the node loads; False where ROS is not installed."""
    import importlib

    try:
        importlib.import_module(MIDDLEWARE)
    except ImportError:
        return False
    return True


def message_of(points: Array) -> Any:
    """A PointCloud2 in all but its class."""
    return SimpleNamespace(header=SimpleNamespace(frame_id="sensor", stamp=SimpleNamespace(sec=0, nanosec=0)),
                           **vars(cloud_layout(points)))  # fmt: skip


def draw(samples: Array, path: Path) -> None:
    """Resident set against pairs."""
    figure = new_figure(8.0, 3.5)
    axes = figure.add_subplot()
    axes.plot(samples)
    axes.set(xlabel="pairs", ylabel="resident set [MB]", ylim=(0.0, None), title="The node's worker")
    axes.grid(alpha=0.3)
    write_figure(figure, path)


if __name__ == "__main__":
    main()
