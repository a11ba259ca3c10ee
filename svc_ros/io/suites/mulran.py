"""Folders as MulRan has them: `Ouster/STAMP.bin`, named by the stamp in nanoseconds, and `global_pose.csv`.

A line of global_pose.csv is a stamp [ns] and the 12 numbers of a 3x4 pose of the vehicle. The scanner's place on the
vehicle is that of MulRan's car unless the folder has a `base_to_ouster.txt` (12 or 16 numbers). The folder itself may
be such a sequence, or hold several.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import make_pose
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_matrix
from svc_ros.io.suites.kitti import CRITERIA
from svc_ros.io.suites.spacing import pair_by_distance
from svc_ros.io.suites.suite import Suite, SuitePair, pair_of_drive, suite_of_drives
from svc_ros.io.trajectories import Trajectory
from svc_ros.io.transform_files import read_transform

_POSES, _SCANS, _MOUNTING = "global_pose.csv", "Ouster", "base_to_ouster.txt"
_MULRAN_TRANSLATION_M = (1.7042, -0.021, 1.8047)
_MULRAN_ROLL_PITCH_YAW_DEG = (0.0001, 0.0003, 179.6654)


def read_mulran(root: Path) -> Suite:
    """Pairs about 10 m apart of one sequence or of several; scans before the first or after the last pose are left out.

    Raises InputError.
    """
    found = [folder for folder in (root, *sorted(root.iterdir())) if (folder / _SCANS).is_dir()]
    if not found:
        raise InputError(f"{root}: expected {_SCANS}/*.bin and {_POSES} in it or in its folders, found none")
    pairs = [pair for folder in found for pair in _pairs_of(root, folder)]
    suite = suite_of_drives(root, f"MulRan, 10 m, {root.resolve().name}", "Ouster OS1-64", pairs, CRITERIA)
    return dataclasses.replace(suite, refined=root / "icp")


def _pairs_of(root: Path, folder: Path) -> Iterator[SuitePair]:
    scans = {int(path.stem): path for path in (folder / _SCANS).glob("*.bin") if path.stem.isdecimal()}
    if not scans:
        raise InputError(f"{folder / _SCANS}: expected scans named by their stamp in nanoseconds, found none")
    trajectory, T_base_scanner = read_poses(folder / _POSES), _mounting(folder)
    placed = {}
    for stamp in sorted(scans):
        try:
            placed[stamp] = trajectory.at(stamp) @ T_base_scanner
        except TransformUnavailableError:
            continue  # recorded before the first pose or after the last one
    if not placed:
        raise InputError(f"{folder}: expected scans within the time of {_POSES}, found none of {len(scans)}")
    stamps = list(placed)
    positions = np.stack([T[:3, 3] for T in placed.values()])
    group = folder.resolve().name
    for a, b in pair_by_distance(positions):
        source, target = stamps[a], stamps[b]
        yield pair_of_drive(
            root, (scans[source], scans[target]), (placed[source], placed[target]),
            name=f"{group}/{source}_{target}", group=group, indices=(b, a),
        )  # fmt: skip


def read_poses(path: Path) -> Trajectory:
    """The vehicle's poses, world <- vehicle [m]; a line with a stamp that was there before is skipped.

    Raises InputError naming file and line.
    """
    poses: dict[int, Array] = {}
    for place, line in placed_lines(path):
        words = [word for word in line.replace(",", " ").split() if word]
        if not words:
            continue
        if len(words) != 13 or not words[0].isdecimal():
            raise InputError(f"{place}: expected a stamp [ns] and 12 numbers, found {line:.60}")
        poses.setdefault(int(words[0]), pose_from_matrix(parse_numbers(words[1:], place), place))
    if not poses:
        raise InputError(f"{path}: expected lines of a stamp [ns] and 12 numbers, found none")
    stamps = sorted(poses)
    return Trajectory(np.array(stamps, np.int64), np.stack([poses[stamp] for stamp in stamps]))


def _mounting(folder: Path) -> Array:
    if (folder / _MOUNTING).is_file():
        return read_transform(folder / _MOUNTING)
    rotation = Rotation.from_euler("xyz", _MULRAN_ROLL_PITCH_YAW_DEG, degrees=True)
    return make_pose(rotation.as_matrix(), np.array(_MULRAN_TRANSLATION_M))
