"""A furnished room of boxes, scanned exactly in numpy: scans with known poses in milliseconds, and files of them."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.core.se3 import invert, make_pose

ROOM = np.array([[-6.0, -4.0, 0.0], [7.0, 5.0, 3.5]])
FURNITURE = np.array(
    [
        [[2.0, -4.0, 0.0], [3.2, -2.5, 2.2]],
        [[-6.0, 2.0, 0.0], [-4.5, 5.0, 1.2]],
        [[4.5, 2.5, 0.0], [7.0, 3.6, 0.9]],
        [[-3.0, -3.0, 0.0], [-2.2, -2.2, 3.5]],
        [[0.5, 3.5, 1.0], [2.5, 5.0, 2.0]],
    ]
)


def sensor_pose(x: float, y: float, yaw_deg: float) -> np.ndarray:
    """Pose (4, 4) world <- sensor, 1.2 m above the floor."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return make_pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], (x, y, 1.2))


def scan_room(T_world_sensor: np.ndarray, seed: int = 0) -> np.ndarray:
    """Points (N, 3) [m] of 40 beams x 360 directions in the sensor's frame, with 5 mm of noise along the ray."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(360)), np.radians(np.linspace(-40, 40, 40)))
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)
    directions, origin = rays @ T_world_sensor[:3, :3].T, T_world_sensor[:3, 3]
    distance = _slabs(ROOM, origin, directions)[1]
    for box in FURNITURE:
        entry, leave = _slabs(box, origin, directions)
        hit = (entry < leave) & (entry > 0)
        distance = np.where(hit, np.minimum(distance, entry), distance)
    noise = np.random.default_rng(seed).normal(0.0, 0.005, len(rays))
    return rays * (distance + noise)[:, None]


def _slabs(box: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(divide="ignore"):
        hits = (box[:, None] - origin) / directions
    return hits.min(0).max(-1), hits.max(0).min(-1)


POSES = [sensor_pose(0.0, 0.0, 0.0), sensor_pose(0.8, 0.4, 25.0), sensor_pose(1.2, 1.0, -40.0)]


def pose_between(source: int, target: int) -> np.ndarray:
    """T_target_source of two of the POSES."""
    return invert(POSES[target]) @ POSES[source]


def write_bin(path: Path, points: np.ndarray) -> Path:
    """KITTI's form: float32 x y z intensity."""
    np.column_stack([points, np.zeros(len(points))]).astype(np.float32).tofile(path)
    return path


def write_scans(folder: Path) -> list[Path]:
    """One .bin a pose."""
    folder.mkdir(exist_ok=True)
    return [write_bin(folder / f"{k}.bin", scan_room(T, seed=k)) for k, T in enumerate(POSES)]


def write_dataset(folder: Path) -> Path:
    """Three pairs, one of them with too few points; one negative; labelled poses of one pair."""
    folder.mkdir(exist_ok=True)
    write_scans(folder / "scans")
    write_bin(folder / "scans" / "few.bin", np.ones((5, 3)) * 2.0)
    pairs = [(1, 0), (2, 1)]
    entries = [
        {"source": f"scans/{s}.bin", "target": f"scans/{t}.bin", "T_target_source": pose_between(s, t).tolist(),
         "overlap": 0.8}
        for s, t in pairs
    ]  # fmt: skip
    entries.append(entries[0] | {"source": "scans/few.bin"})
    dataset = {
        "name": "room", "sensor": "boxes", "preset": "lidar_indoor", "min_range_m": 0.3, "max_range_m": 30.0,
        "sensor_origin": [0, 0, 0], "success": {"rotation_deg": 5.0, "translation_m": 0.6},
        "pairs": entries, "negatives": [{"source": "scans/few.bin", "target": "scans/0.bin"}],
    }  # fmt: skip
    right = pose_between(1, 0)
    far = right.copy()
    far[:3, 3] += (3.0, -2.0, 0.0)
    candidates = [
        {"T_target_source": right.tolist(), "label": "correct", "origin": "reference"},
        {"T_target_source": far.tolist(), "label": "wrong", "origin": "far"},
        {"T_target_source": far.tolist(), "label": "grey", "origin": "slip"},
    ]
    judged = {"pairs": [{"source": "scans/1.bin", "target": "scans/0.bin", "candidates": candidates}]}
    (folder / "dataset.json").write_text(json.dumps(dataset))
    (folder / "candidates.json").write_text(json.dumps(judged))
    return folder


def without_times(report: dict[str, Any]) -> dict[str, Any]:
    """The report of an evaluation, of one data set or several, without what takes another time in every run."""
    report = copy.deepcopy(report)
    for one in report.get("datasets", [report]):
        del one["time_ms"]
        for row in [*one["registration"]["pairs"], *(one["negatives"] or {"pairs": []})["pairs"]]:
            del row["time_ms"]
    return report
