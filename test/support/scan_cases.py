"""Prepared scans for tests: random ones, built ones, and thinned real ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from mini_data import POSES, pose_between, scan_room

from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.io.datasets import read_dataset

T_ROOM = pose_between(1, 0)


def prepared(
    points: np.ndarray, normals: np.ndarray | None = None, origin: tuple[float, ...] = (0, 0, 0)
) -> PreparedScan:
    """Points as they are; normals towards the sensor unless given."""
    points, origin_array = np.asarray(points, float).reshape(-1, 3), np.asarray(origin, float)
    if normals is None:
        normals = (origin_array - points) / np.linalg.norm(origin_array - points, axis=1, keepdims=True)
    return PreparedScan(points, np.asarray(normals, float), origin_array, 0.3)


def random_scan(num: int, seed: int, spread: float = 8.0, origin: tuple[float, ...] = (0, 0, 0)) -> PreparedScan:
    """Points in all directions with normals in all directions."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(num, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return prepared(rng.normal(size=(num, 3)) * spread, normals, origin)


def room_config(**values: object) -> Config:
    """Settings that fit the furnished room; dots of names are written as two underscores."""
    base = {"preprocess.voxel_size_m": 0.2, "preprocess.min_range_m": 0.3, "preprocess.max_range_m": 30.0,
            "matching.max_correspondences": 800}  # fmt: skip
    return with_values(preset("lidar_indoor"), base | {name.replace("__", "."): v for name, v in values.items()})


def room_scans() -> tuple[Scan, Scan]:
    """Source and target, a step and a turn apart: T_ROOM is the pose between them."""
    return Scan(scan_room(POSES[1], seed=1)), Scan(scan_room(POSES[0], seed=0))


def real_pair(shared_data: Path, name: str, index: int = 0) -> tuple[Scan, Scan, np.ndarray, Config]:
    """Source and target of one pair of a data set, the reference pose, and the config that fits."""
    dataset = read_dataset(shared_data / "pairs" / name)
    pair = dataset.pairs[index]
    limits = {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    config = with_values(preset(dataset.preset), limits)
    return dataset.read_scan(pair.source), dataset.read_scan(pair.target), pair.T_target_source, config


def thin(scan: PreparedScan, num: int) -> PreparedScan:
    """About `num` of the points, evenly taken."""
    step = max(1, len(scan) // num)
    return dataclasses.replace(scan, points=scan.points[::step], normals=scan.normals[::step], memo={})
