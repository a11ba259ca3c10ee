"""Is a place found again among many by its look? Recall at 1, 5 and 10 and time, beside map-closures.

    python benchmarks/place_search.py [--peer PYTHON] [--data DIR] [--out DIR]

Walks and drives that come back, recorded and simulated, one after the other as one sequence for each preset: each scan
is asked for among all before it that are MIN_GAP_S older, those of other drives too. It is found if one of the first k
stands within a few metres of it. PYTHON names an interpreter with map-closures (default: this one; without it, ours
alone). map-closures is made for local maps: it gets single scans, and local maps of the last 5 scans, laid
together by their true poses as its own pipeline does it, at two resolutions; ours sees single scans only.
Writes place-search.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import console, describe_run, parse_options, print_table, write_report

from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Array, Scan
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import read_tum
from svc_ros.pipeline.place import look_at_place
from svc_ros.pipeline.place_search import PlaceIndex
from svc_ros.simulation import DriveConfig, drive_scans

NEAR_M = {"lidar_indoor": 2.0, "lidar_outdoor": 5.0}  # so near it is the same place
RESOLUTIONS_M = {"lidar_indoor": (0.25, 0.5), "lidar_outdoor": (0.5, 1.0)}  # of map-closures; its own is 0.5
MIN_GAP_S = 10.0
FIRST = (1, 5, 10)
LOCAL_MAPS = (1, 5)  # scans in each
MOST = 40  # that the peer is asked for, of which some are too young to count
SEEDS = (0, 1)
DRIVES = (("street", "OS1-64", "lidar_outdoor"), ("street", "VLP-16", "lidar_outdoor"),
          ("indoor", "OS0-64", "lidar_indoor"), ("corridor_features", "OS0-64", "lidar_indoor"))  # fmt: skip
NUM_SCANS, RATE_HZ = 40, 1.0
PEER = Path(__file__).parent / "lib" / "closures_peer.py"


@dataclass(frozen=True, eq=False)
class Seen:
    """One scan of a drive, and its pose (4, 4)."""

    drive: str
    scan: Scan
    T: Array


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--peer", default=sys.executable, help="interpreter with map-closures")

    options = parse_options("Places found again by their look.", extend, workers=False)
    run, results = describe_run([]), {}
    for name in NEAR_M:
        sequence = [seen for drive in drives(name, options.data.parent) for seen in drive]
        wanted = relevant(sequence, NEAR_M[name])
        rows = {"ours, one scan": ours(sequence, wanted, name)}
        if has_peer(options.peer):
            rows |= peers(sequence, wanted, name, options.peer)
        else:
            console.print(f"map-closures is not installed in {options.peer}")
        columns = [f"recall at {k}" for k in FIRST] + ["ms a scan"]
        print_table(f"{name}: {len(sequence)} scans, {len(wanted)} come back", ["", *columns],
                    [[label, *(row[column] for column in columns)] for label, row in rows.items()])  # fmt: skip
        results[name] = {"scans": len(sequence), "asked": len(wanted), "rows": rows}
    settings = {"near_m": NEAR_M, "min_gap_s": MIN_GAP_S, "seeds": SEEDS}
    write_report(options.out / "place-search.json", {**settings, "results": results}, run)


def drives(preset_name: str, data: Path) -> Iterator[list[Seen]]:
    """Recorded and simulated drives of one preset."""
    walk = data / "bags" / "os0_64_walk"
    if preset_name == "lidar_indoor" and walk.is_dir():
        reference = read_tum(walk / "reference_tum.txt")
        with Bag(walk / "ros2_mcap") as bag:
            scans = [reading.scan for reading in bag.scans()]
        yield [Seen("os0_64_walk", scan, reference.at(scan.stamp_ns)) for scan in scans]
    for scene, sensor, name in DRIVES:
        for seed in SEEDS if name == preset_name else ():
            label = f"{scene} {sensor} {seed}"
            config = DriveConfig(scene, sensor, NUM_SCANS, None, RATE_HZ, seed, there_and_back=True)
            yield [
                Seen(label, dataclasses.replace(found.cast.scan(), stamp_ns=found.stamp_ns), found.T_map_lidar)
                for found in drive_scans(config)
            ]


def old_enough(sequence: Sequence[Seen], number: int) -> Array:
    """Numbers of the scans before one that are not its neighbours in time."""
    this = sequence[number]
    gap_ns = MIN_GAP_S * 1e9
    return np.array([
        k for k in range(number)
        if sequence[k].drive != this.drive or this.scan.stamp_ns - sequence[k].scan.stamp_ns >= gap_ns
    ], np.int64)  # fmt: skip


def relevant(sequence: Sequence[Seen], near_m: float) -> dict[int, set[int]]:
    """Of every scan that comes back, the earlier ones of the same place."""
    found: dict[int, set[int]] = {}
    for number, this in enumerate(sequence):
        near = {
            int(k) for k in old_enough(sequence, number)
            if sequence[k].drive == this.drive and np.linalg.norm(sequence[k].T[:3, 3] - this.T[:3, 3]) <= near_m
        }  # fmt: skip
        if near:
            found[number] = near
    return found


def ours(sequence: Sequence[Seen], wanted: dict[int, set[int]], preset_name: str) -> dict[str, float]:
    """The index, asked with single scans; its time with the look of the scan, but not with its preparation."""
    config, found, times = preset(preset_name), {}, []
    index = PlaceIndex()
    for number, seen in enumerate(sequence):
        scan = prepare(seen.scan, config)
        begun = time.perf_counter()
        look = look_at_place(scan)
        found[number] = [k for k, _ in index.most_alike(look, len(sequence))]
        times.append(1e3 * (time.perf_counter() - begun))
        index.add(look)
    return recalls(sequence, wanted, found, times)


def peers(
    sequence: Sequence[Seen], wanted: dict[int, set[int]], preset_name: str, python: str
) -> dict[str, dict[str, float]]:
    """map-closures with local maps of several sizes and resolutions."""
    rows = {}
    drive_names = sorted({seen.drive for seen in sequence})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scans.npz"
        np.savez(
            path, points=np.concatenate([seen.scan.points for seen in sequence]).astype(np.float32),
            ends=np.cumsum([len(seen.scan) for seen in sequence]), poses=np.array([seen.T for seen in sequence]),
            drives=np.array([drive_names.index(seen.drive) for seen in sequence]),
        )  # fmt: skip
        for size, resolution in product(LOCAL_MAPS, RESOLUTIONS_M[preset_name]):
            words = [python, str(PEER), str(path), str(resolution), str(size), str(MOST)]
            done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
            told = json.loads(done.stdout)
            label = f"map-closures, {size} scan{'s' * (size > 1)}, {resolution:g} m"
            rows[label] = recalls(sequence, wanted, dict(enumerate(told["found"])), told["ms"])
    return rows


def recalls(
    sequence: Sequence[Seen], wanted: dict[int, set[int]], found: dict[int, list[int]], times: Sequence[float]
) -> dict[str, float]:
    """Shares of the scans that come back of which the place is among the first k, and the median time."""
    told: dict[str, Any] = {}
    ranked = {k: [each for each in found[k] if each in set(old_enough(sequence, k).tolist())] for k in wanted}
    for first in FIRST:
        hits = sum(bool(near & set(ranked[k][:first])) for k, near in wanted.items())
        told[f"recall at {first}"] = hits / max(len(wanted), 1)
    return {**told, "ms a scan": float(np.median(times))}


def has_peer(python: str) -> bool:
    """Whether that interpreter has map-closures."""
    done = subprocess.run([python, "-c", "import map_closures"], stderr=subprocess.DEVNULL)
    return done.returncode == 0


if __name__ == "__main__":
    main()
