"""nuScenes by published pair lists: LoNuScenes (GCL, ICCV 2023) and RotNuScenes (UMERegRobust, ECCV 2024).

A list names a log and two of its keyframes, counted from 0 in the order of sample.json. Understood are nuScenes itself
(`v1.0-test/*.json`, `samples/LIDAR_TOP/*.pcd.bin`) and what export_kitti_minimal.py of both repositories makes of it:
`test/sequences/LOG/velodyne/000000.bin`, whose axes are turned by 90 deg about z, and `test/sequences/LOG/poses.npy`.
References are those of the list, in the axes of the export, else nuScenes' own poses.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import check_pose, invert, make_pose, nearest_pose
from svc_ros.io.pose_text import pose_from_values
from svc_ros.io.suites.kitti_lists import LOW_OVERLAP_CRITERIA, ROTATED_CRITERIA
from svc_ros.io.suites.pair_list import (
    ListedPair,
    angle_range,
    distance_range,
    in_groups,
    pose_between,
    read_array,
    read_array_list,
    suite_pair,
)
from svc_ros.io.suites.suite import Suite, SuitePair, suite_of_drives

SENSOR, _CHANNEL = "Velodyne HDL-32E", "LIDAR_TOP"
_SPLITS = ("test", "val", "train", "")
_VERSIONS = ("v1.0-test", "v1.0-trainval", "v1.0-mini")
_LAYOUT = f"{_VERSIONS[0]}/*.json or {_SPLITS[0]}/sequences/LOG/velodyne/*.bin"
# Points of the export p_export into the scanner's own axes: p_scan = T p_export.
_T_SCAN_EXPORT = make_pose([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.zeros(3))
_AS_STORED = np.eye(4)


def read_lonuscenes(root: Path) -> Suite:
    """LoNuScenes, overlap below 0.3: groups are ranges of ten metres. Raises InputError."""
    pairs = in_groups(_pairs_of(root, read_array_list(root, "lonuscenes")), distance_range)
    return suite_of_drives(root, "LoNuScenes", SENSOR, pairs, LOW_OVERLAP_CRITERIA)


def read_rotnuscenes(root: Path) -> Suite:
    """RotNuScenes, turns of 30 to 180 deg: groups are ranges of 30 deg. Raises InputError."""
    pairs = in_groups(_pairs_of(root, read_array_list(root, "rotnuscenes")), angle_range)
    return suite_of_drives(root, "RotNuScenes", SENSOR, pairs, ROTATED_CRITERIA)


@dataclass(frozen=True, eq=False)
class _Log:
    """Keyframes of a log. scans: their files; poses: (N, 4, 4) [m], world <- scan, from the file `origin`;
    T_scan_export (4, 4): from the axes in which lists have their references into those of the scans."""

    scans: Sequence[Path]
    poses: Array
    origin: Path
    T_scan_export: Array


def _pairs_of(root: Path, listed: Sequence[ListedPair]) -> list[SuitePair]:
    names = list(dict.fromkeys(pair.sequence for pair in listed))
    logs = _read_export(root, names) or _read_tables(root, names)
    return [_pair_of(pair, logs, root) for pair in listed]


def _pair_of(pair: ListedPair, logs: Mapping[str, _Log], root: Path) -> SuitePair:
    log = logs.get(pair.sequence)
    if log is None:
        raise InputError(f"{pair.place}: expected the keyframes of {pair.sequence} in {root}, found none")
    T = pose_between(pair, log.poses, log.origin)
    if pair.T_target_source is not None:
        T = nearest_pose(log.T_scan_export @ pair.T_target_source @ invert(log.T_scan_export))
    scans = [log.scans[frame] for frame in (pair.source, pair.target)]
    return suite_pair(pair, scans, T, root, f"{pair.sequence}/{pair.source}_{pair.target}")


def _read_export(root: Path, names: Sequence[str]) -> dict[str, _Log]:
    """Logs by name as export_kitti_minimal.py writes them; empty where there is none of them."""
    found = {}
    for name in names:
        folders = (root / split / "sequences" / name for split in _SPLITS)
        folder = next((folder for folder in folders if (folder / "velodyne").is_dir()), None)
        if folder is not None:
            path = folder / "poses.npy"
            poses = read_array(path)
            if poses.ndim != 3 or poses.dtype.kind != "f":
                raise InputError(f"{path}: expected 4x4 matrices, found {poses.dtype} of shape {poses.shape}")
            world = np.stack([check_pose(T, f"{path}: row {k}") for k, T in enumerate(poses)])
            scans = [folder / "velodyne" / f"{k:06d}.bin" for k in range(len(world))]
            found[name] = _Log(scans, world, path, _AS_STORED)
    return found


def _read_tables(root: Path, names: Sequence[str]) -> dict[str, _Log]:
    """Logs by name from nuScenes' own tables, of the first version that is there."""
    folder = next((root / version for version in _VERSIONS if (root / version).is_dir()), None)
    if folder is None:
        raise InputError(f"{root}: expected {_LAYOUT}, found none")
    scenes, logs, samples = (_Table(folder, name) for name in ("scene", "log", "sample"))
    scans, sensors, egos = (_Table(folder, name) for name in ("sample_data", "calibrated_sensor", "ego_pose"))
    scan_of_sample = _lidar_keyframes(scans, sensors, _Table(folder, "sensor"))
    keyframes: dict[str, list[str]] = {name: [] for name in names}
    for sample in samples.rows:
        name = logs.get(scenes.get(samples.get(sample, "scene_token"), "log_token"), "logfile")
        if name in keyframes:
            if sample not in scan_of_sample:
                raise InputError(f"{scans.path}: expected a keyframe of {_CHANNEL} for sample {sample}, found none")
            keyframes[name].append(scan_of_sample[sample])
    found = {}
    for name, tokens in keyframes.items():
        poses = [
            egos.pose(scans.get(token, "ego_pose_token")) @ sensors.pose(scans.get(token, "calibrated_sensor_token"))
            for token in tokens
        ]
        files = [root / scans.get(token, "filename") for token in tokens]
        if files:
            found[name] = _Log(files, np.stack(poses), egos.path, _T_SCAN_EXPORT)
    return found


def _lidar_keyframes(scans: _Table, calibrated: _Table, sensors: _Table) -> dict[str, str]:
    """Token of the scan by the token of its sample, keyframes of the LiDAR only."""
    return {
        scans.get(token, "sample_token"): token
        for token in scans.rows
        if scans.get(token, "is_key_frame")
        and sensors.get(
            calibrated.get(scans.get(token, "calibrated_sensor_token"), "sensor_token"), "channel"
        ) == _CHANNEL
    }  # fmt: skip


class _Table:
    """A table of nuScenes by tokens, in file order; what is missing is told with the file."""

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / f"{name}.json"
        try:
            rows = json.loads(self.path.read_text("utf-8"))
            self.rows: dict[str, Mapping[str, Any]] = {row["token"]: row for row in rows}
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from None
        except ValueError as error:  # broken UTF-8 or JSON
            raise InputError(f"{self.path}: expected JSON: {error}") from None
        except (KeyError, TypeError):
            raise InputError(f"{self.path}: expected a list of objects, each with its token") from None

    def get(self, token: str, key: str) -> Any:
        """The value of a row. Raises InputError where there is none."""
        try:
            return self.rows[token][key]
        except (KeyError, TypeError):
            raise InputError(f"{self.path}: expected {key} of token {token!r:.60}, found none") from None

    def pose(self, token: str) -> Array:
        """Pose (4, 4) [m] of a row: translation, and rotation as w x y z. Raises InputError."""
        place = f"{self.path}: token {token:.60}"
        translation, rotation = self.get(token, "translation"), self.get(token, "rotation")
        try:
            x, y, z = map(float, translation)
            w, *vector = map(float, rotation)
            values = np.array([x, y, z, *vector, w])
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (7,) or not np.isfinite(values).all():
            raise InputError(
                f"{place}: expected a translation x y z and a rotation w x y z, found {translation!r:.60} "
                f"and {rotation!r:.80}"
            )
        return pose_from_values(values, place)
