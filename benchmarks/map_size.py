"""How long does a large map take to read and to search, and how much memory? Ten thousand keyframes.

    python benchmarks/map_size.py [--keyframes N] [--scene NAME --sensor NAME --preset NAME] [--work DIR] [--out DIR]

The keyframes are those of a few simulated scans, over and over, each with a look of its own, at places along a winding
way. A process of its own reads the map, searches it and visits keyframes. Writes map-size.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import PROJECT_ROOT, describe_run, parse_options, print_table, write_report

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.maps.layout import MapGraph, Session
from svc_ros.io.maps.writing import MapWriter
from svc_ros.pipeline.graph_optimisation import optimise
from svc_ros.pipeline.place import look_at_place
from svc_ros.simulation import DriveConfig, drive_scans

NUM_SCANS = 20
STEP_M, TURN_DEG = 2.0, 7.0  # from one keyframe to the next; the way winds
LOOP_EVERY, LOOP_BACK = 5, 150  # every fifth keyframe has a loop with one so far back
SEARCHES, VISITS = 200, 500


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--keyframes", type=int, default=10_000, help="keyframes of the map")
        parser.add_argument("--scene", default="indoor", help="what is simulated")
        parser.add_argument("--sensor", default="OS0-64", help="seen by")
        parser.add_argument("--preset", default="lidar_indoor", help="of the map")
        parser.add_argument("--work", type=Path, help="folder with room for the map, half a megabyte a keyframe")

    options = parse_options("A large map: reading, searching, memory.", extend, workers=False)
    run = describe_run([])
    with tempfile.TemporaryDirectory(prefix="svc_ros_map_", dir=options.work) as folder:
        found = measure(options, Path(folder) / "map")
    print_table("Map", list(found), [list(found.values())])
    settings = {name: getattr(options, name) for name in ("scene", "sensor", "preset")}
    write_report(options.out / "map-size.json", {**settings, **found, "load": os.getloadavg()[0]}, run)


def measure(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Write the map, and have it read and used by another process."""
    config = preset(options.preset)
    drive = DriveConfig(scene=options.scene, sensor=options.sensor, num_scans=NUM_SCANS)
    scans = [prepare(scan.cast.scan(), config) for scan in drive_scans(drive)]
    graph = winding_graph(options.keyframes)
    begun = time.perf_counter()
    best = optimise(graph)
    optimised_s, begun = time.perf_counter() - begun, time.perf_counter()
    folder.mkdir()
    writer = MapWriter(folder)
    write_keyframes(writer, scans, options.keyframes)
    writer.finish(MapGraph(best.poses, best.covariances, graph.edges), [Session("simulated", "lidar")], config)
    written_s = time.perf_counter() - begun
    size_mb = 1e-6 * sum(file.stat().st_size for file in folder.iterdir())
    command = [sys.executable, "-m", "lib.map_reader", str(folder), str(SEARCHES), str(VISITS)]
    paths = os.pathsep.join([str(PROJECT_ROOT / "benchmarks"), str(PROJECT_ROOT)])
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": paths}, stdout=subprocess.PIPE, text=True, check=True
    )
    points = float(np.mean([len(scan) for scan in scans]))
    return {
        **json.loads(done.stdout), "points": points, "size_mb": size_mb, "optimise_s": optimised_s, "write_s": written_s
    }  # fmt: skip


def write_keyframes(writer: MapWriter, scans: list[PreparedScan], num: int) -> None:
    """The scans in turn; the look of each keyframe is that of two scans mixed, turned and noisy."""
    rng = np.random.default_rng(0)
    looks = np.array([look_at_place(scan).spectrum for scan in scans])
    frequencies = np.arange(looks.shape[2])
    for number in range(num):
        first, second = rng.integers(len(looks), size=2)
        turn = np.exp(2j * np.pi * rng.random() * frequencies)
        mixed = looks[first] + rng.random() * turn * looks[second]
        mixed = mixed + 0.05 * (rng.normal(size=mixed.shape) + 1j * rng.normal(size=mixed.shape))
        scan = scans[number % len(scans)]
        writer.add(scan, (mixed / energy(mixed) ** 0.5).astype(np.complex64), 0)


def energy(spectrum: Array) -> float:
    """Of the counts that a spectrum is of."""
    return float(np.square(np.fft.irfft(spectrum, axis=1)).sum())


def winding_graph(num: int) -> PoseGraph:
    """Poses along the way, as odometry and loops have them."""
    turns = np.radians(TURN_DEG) * np.sin(np.arange(num) / 9.0)
    steps = [se3.make_pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], (STEP_M, 0, 0))
             for c, s in zip(np.cos(turns), np.sin(turns), strict=True)]  # fmt: skip
    poses = [np.eye(4)]
    for step in steps[1:]:
        poses.append(se3.nearest_pose(poses[-1] @ step))
    ends = [(k, k - 1) for k in range(1, num)] + [(k, k - LOOP_BACK) for k in range(LOOP_BACK, num, LOOP_EVERY)]
    variances = np.diag([1e-3] * 3 + [1e-5] * 3)
    return PoseGraph(np.array(poses), [GraphEdge(a, b, se3.invert(poses[b]) @ poses[a], variances) for a, b in ends])


if __name__ == "__main__":
    main()
