"""KITTI odometry by published pair lists: loop closures in three ranges, LoKITTI and RotKITTI.

Layout: scans as for the 10 m pairs (`sequences/08/velodyne/000000.bin`), the lists beside them. Loop closures are
those of LiDAR-Registration-Benchmark and G3Reg (IEEE T-ASE 2024); LoKITTI, overlap below 0.3, comes from GCL (ICCV
2023), RotKITTI, turns of 30 to 180 deg, from UMERegRobust (ECCV 2024). References are those of the lists, which come
from SemanticKITTI's poses; a list without is read with these: `sequences/08/poses.txt` and `calib.txt`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.suites.kitti import SENSOR, find_base, read_calibration
from svc_ros.io.suites.pair_list import (
    ListedPair,
    angle_range,
    distance_range,
    find_list,
    in_groups,
    pose_between,
    read_array_list,
    read_text_list,
    suite_pair,
)
from svc_ros.io.suites.suite import Criterion, Suite, SuitePair, suite_of_drives
from svc_ros.io.trajectories import read_kitti as read_poses

LOOP_RANGES = {"0-10 m": "test_0_10.txt", "10-20 m": "test_10_20.txt", "20-30 m": "test_20_30.txt"}
LOOP_FOLDERS = ("", "kitti_lc", "benchmarks/kitti_lc", "configs/datasets/kitti_lc")
LOOP_CRITERIA = (Criterion.within(5.0, 2.0),)  # of the benchmark and of G3Reg
# GCL's, then UMERegRobust's two (its page: normal and strict precision); RotKITTI is UMERegRobust's own.
LOW_OVERLAP_CRITERIA = (Criterion.within(5.0, 2.0), Criterion.within(1.5, 0.3), Criterion.within(1.0, 0.1))
ROTATED_CRITERIA = (Criterion.within(1.5, 0.3), Criterion.within(1.0, 0.1), Criterion.within(5.0, 2.0))
MAX_DISTANCE_M = 50.0  # UMERegRobust evaluates no pair farther apart
LIST_OF_GCL = "file_LoKITTI_50.npy"  # without poses
_SCANS = "sequences/08/velodyne/*.bin"


def read_kitti_loops(root: Path) -> Suite:
    """Loop closures of those of the three ranges and of the sequences (00, 02, 05, 06, 08) that are there.

    3325 pairs where all are; groups are the ranges. Raises InputError.
    """
    drives = _Drives(root)
    folder = find_list(root, LOOP_FOLDERS, tuple(LOOP_RANGES.values())).parent
    lists = {group: folder / name for group, name in LOOP_RANGES.items() if (folder / name).is_file()}
    pairs = [
        dataclasses.replace(pair, group=group)
        for group, path in lists.items()
        for pair in drives.pairs_of(read_text_list(path))
    ]
    return _suite(root, "KITTI loop closures", pairs, LOOP_CRITERIA)


def read_lokitti(root: Path) -> Suite:
    """LoKITTI: pairs of the list whose sequences are there; groups are ranges of ten metres. Raises InputError."""
    pairs = _Drives(root).pairs_of(read_array_list(root, "lokitti", (LIST_OF_GCL,)))
    return _suite(root, "LoKITTI", in_groups(_near(pairs), distance_range), LOW_OVERLAP_CRITERIA)


def read_rotkitti(root: Path) -> Suite:
    """RotKITTI: pairs of the list whose sequences are there; groups are ranges of 30 deg. Raises InputError."""
    pairs = _Drives(root).pairs_of(read_array_list(root, "rotkitti"))
    return _suite(root, "RotKITTI", in_groups(_near(pairs), angle_range), ROTATED_CRITERIA)


def _near(pairs: Iterable[SuitePair]) -> Iterator[SuitePair]:
    return (pair for pair in pairs if (pair.distance_m or 0.0) <= MAX_DISTANCE_M)


def _suite(root: Path, name: str, pairs: Sequence[SuitePair], criteria: tuple[Criterion, ...]) -> Suite:
    if not pairs:
        raise InputError(f"{root}: expected the scans of a sequence that the pair list names, found none")
    return suite_of_drives(root, name, SENSOR, pairs, criteria)


class _Drives:
    """The sequences below a folder; poses are read once a sequence, and only where a list has none."""

    def __init__(self, root: Path) -> None:
        base = find_base(root)
        if base is None:
            raise InputError(f"{root}: expected {_SCANS} in it or in its dataset/, found none")
        self._root, self._sequences = root, base / "sequences"
        self._world_velodyne: dict[Path, Array] = {}

    def pairs_of(self, listed: Iterable[ListedPair]) -> list[SuitePair]:
        """Those pairs of a list whose sequence is there, with references, in its order."""
        folders = [(pair, self._folder_of(pair)) for pair in listed]
        return [self._pair_of(pair, folder) for pair, folder in folders if (folder / "velodyne").is_dir()]

    def _folder_of(self, pair: ListedPair) -> Path:
        if not pair.sequence.isdecimal():
            raise InputError(f"{pair.place}: expected the number of a sequence, found {pair.sequence:.40}")
        return self._sequences / f"{int(pair.sequence):02d}"

    def _pair_of(self, pair: ListedPair, folder: Path) -> SuitePair:
        T = self._reference(pair, folder) if pair.T_target_source is None else pair.T_target_source
        scans = [folder / "velodyne" / f"{frame:06d}.bin" for frame in (pair.source, pair.target)]
        return suite_pair(pair, scans, T, self._root, f"{int(pair.sequence)}_{pair.source}_{pair.target}")

    def _reference(self, pair: ListedPair, folder: Path) -> Array:
        """T_target_source (4, 4) [m] by SemanticKITTI's poses."""
        if folder not in self._world_velodyne:
            self._world_velodyne[folder] = read_poses(folder / "poses.txt") @ read_calibration(folder / "calib.txt")
        return pose_between(pair, self._world_velodyne[folder], folder / "poses.txt")
