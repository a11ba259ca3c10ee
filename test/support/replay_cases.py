"""A small bag for the tests of the replay: a way out and back through the furnished room."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import mini_data
import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Scan
from svc_ros.io.bags import CloudBagWriter
from svc_ros.io.maps.layout import MapGraph, Session
from svc_ros.io.maps.writing import MapWriter
from svc_ros.io.results import read_jsonl
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.pipeline.place import look_at_place
from svc_ros.replay.job import MODES, ReplayJob
from svc_ros.replay.run import replay_bag

CONFIG = with_values(preset("lidar_indoor"), {"loop_closure.min_gap_s": 0.35, "loop_closure.keyframe_distance_m": 0.2})
START_NS, STEP_NS = 1_700_000_000_123_456_789, 100_000_000
WAY = [mini_data.sensor_pose(x, 0.1 * x, 10 * x) for x in (0.0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0)]
STAMPS = [START_NS + k * STEP_NS for k in range(len(WAY))]
KNOWN = WAY[:4:3]  # what a map has of it, of an earlier day
KNOWN_STAMPS = [START_NS - (90_000 - k) * 1_000_000_000 for k in range(len(KNOWN))]
MOUNTING = se3.make_pose(Rotation.from_euler("z", 20, degrees=True).as_matrix(), (0.3, 0.0, 1.2))
OUTPUTS = {"decisions.jsonl", "trajectory_tum.txt", "loops.g2o", "results.mcap", "config.yaml", "summary.json"}

OPTIMIZED = {"trajectory_optimized_tum.txt"} if importlib.util.find_spec("gtsam") else set()  # needs an extra
OUTPUTS_OF = {mode: OUTPUTS | (OPTIMIZED if mode == "loop_closure" else set()) for mode in MODES}


def write_room_bag(path: Path, broken: tuple[int, ...] = ()) -> Path:
    """TF odom -> base_link -> lidar and /points at 10 Hz; clouds whose numbers are `broken` have six points."""
    with CloudBagWriter(path) as bag:
        bag.write_transform(START_NS, "base_link", "lidar", MOUNTING, static=True)
        for k, T in enumerate(WAY):
            bag.write_transform(STAMPS[k], "odom", "base_link", T @ se3.invert(MOUNTING))
            points = np.eye(6, 3) + 1.0 if k in broken else mini_data.scan_room(T, seed=k)
            bag.write_points(STAMPS[k], "lidar", points)
    return path


def write_reference(path: Path) -> Path:
    """The true way of the lidar."""
    write_tum(path, Trajectory(np.array(STAMPS), np.array(WAY)))
    return path


def room_map(folder: Path) -> Path:
    """A map of the room in the frame of the way's first scan, written where there is none."""
    if not folder.is_dir():
        folder.mkdir()
        writer = MapWriter(folder)
        for stamp_ns, T in zip(KNOWN_STAMPS, KNOWN, strict=True):
            scan = prepare(Scan(mini_data.scan_room(T, seed=30), stamp_ns, "lidar"), CONFIG)
            writer.add(scan, look_at_place(scan).spectrum, 0)
        poses = se3.invert(WAY[0]) @ np.array(KNOWN)
        covariances = np.tile(1e-4 * np.eye(6), (len(KNOWN), 1, 1))
        writer.finish(MapGraph(poses, covariances, []), [Session("room", "lidar")], CONFIG)
    return folder


def write_map_reference(path: Path) -> Path:
    """Where the scans of the map were."""
    write_tum(path, Trajectory(np.array(KNOWN_STAMPS), np.array(KNOWN)))
    return path


def job(bag: Path, out: Path, mode: str = "pair", **more: Any) -> ReplayJob:
    """A job of the room's bag without a report, which costs tenths of a second; to localise, in a map beside it."""
    if mode == "localization":
        more = {"map_folder": room_map(bag.parent / "map"), **more}
        if "reference" in more:
            more = {"map_reference": write_map_reference(bag.parent / "map_reference.txt"), **more}
    config = more.pop("config", CONFIG)
    return ReplayJob(bag, out, config, "lidar_indoor", mode, **{"report": False, **more})


def replay_in_all_modes(bag: Path, folder: Path) -> dict[str, Path]:
    """Folders of one replay in each mode, with a reference."""
    reference = write_reference(folder / "reference.txt")
    for mode in MODES:
        replay_bag(job(bag, folder / mode, mode, reference=reference))
    return {mode: folder / mode for mode in MODES}


def timeless_lines(out: Path) -> list[dict[str, Any]]:
    """The decisions without the times that they took."""
    return [{name: value for name, value in row.items() if name != "time_ms"} for row in read_decisions(out)]


def read_decisions(out: Path) -> list[dict[str, Any]]:
    return read_jsonl(out / "decisions.jsonl")


class StopAfter:
    """Asks to stop once it was asked so many times."""

    def __init__(self, num: int) -> None:
        self.left = num

    def __call__(self) -> bool:
        self.left -= 1
        return self.left <= 0
