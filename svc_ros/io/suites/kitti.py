"""KITTI odometry, sequences 08 to 10: pairs of scans about 10 m apart, as FCGF and Predator evaluate.

Layout: `sequences/08/velodyne/000000.bin`, `sequences/08/calib.txt`, `sequences/08/times.txt`, `poses/08.txt`, in the
folder or in its `dataset/`. The reference is the drive's poses, refined by ICP when a pair is first used.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_matrix
from svc_ros.io.suites.spacing import pair_by_distance
from svc_ros.io.suites.suite import Criterion, Suite, SuitePair, pair_of_drive, suite_of_drives
from svc_ros.io.trajectories import read_kitti as read_poses

SEQUENCES = ("08", "09", "10")
LEFT_OUT = {("08", 15, 58)}  # its reference is known to be wrong; every evaluation leaves it out
CRITERIA = (Criterion.within(5.0, 0.6), Criterion.within(5.0, 2.0))
SENSOR = "Velodyne HDL-64E"
_LAYOUT = "sequences/08/velodyne/*.bin, sequences/08/calib.txt and poses/08.txt (also 09, 10)"


def read_kitti(root: Path) -> Suite:
    """Pairs of those of the sequences 08, 09, 10 that are there: 555 where all are. Raises InputError."""
    base = find_base(root)
    present = [] if base is None else [name for name in SEQUENCES if (base / "sequences" / name / "velodyne").is_dir()]
    if base is None or not present:
        raise InputError(f"{root}: expected {_LAYOUT}, found none of the sequences")
    pairs = [pair for name in present for pair in _pairs_of(root, base, name)]
    suite = suite_of_drives(root, "KITTI odometry, 10 m", SENSOR, pairs, CRITERIA)
    return dataclasses.replace(suite, refined=root / "icp")


def find_base(root: Path) -> Path | None:
    """The folder that holds `sequences/`: the root itself or its `dataset/`; None where neither does."""
    return next((folder for folder in (root, root / "dataset") if (folder / "sequences").is_dir()), None)


def _pairs_of(root: Path, base: Path, sequence: str) -> list[SuitePair]:
    folder = base / "sequences" / sequence
    scans = {int(path.stem): path for path in sorted(folder.glob("velodyne/*.bin")) if path.stem.isdecimal()}
    if not scans:
        raise InputError(f"{folder / 'velodyne'}: expected scans such as 000000.bin, found none")
    world_camera = read_poses(base / "poses" / f"{sequence}.txt")
    _check_times(folder / "times.txt", len(world_camera))
    last = max(scans)
    if last >= len(world_camera):
        raise InputError(
            f"{scans[last]}: expected a pose for each scan, found {len(world_camera)} poses in poses/{sequence}.txt"
        )
    T_camera_velodyne = read_calibration(folder / "calib.txt")
    frames = sorted(scans)
    positions = world_camera[frames, :3, 3]
    world_velodyne = world_camera @ T_camera_velodyne
    chosen = [(frames[a], frames[b]) for a, b in pair_by_distance(positions)]
    return [
        pair_of_drive(
            root, (scans[a], scans[b]), (world_velodyne[a], world_velodyne[b]),
            name=f"{int(sequence)}_{a}_{b}", group=sequence, indices=(b, a),
        )
        for a, b in chosen
        if (sequence, a, b) not in LEFT_OUT
    ]  # fmt: skip


def read_calibration(path: Path) -> Array:
    """T_camera_velodyne (4, 4) [m] of a calib.txt: its line `Tr:`. Raises InputError."""
    for place, line in placed_lines(path):
        key, _, rest = line.partition(":")
        if key.strip() in ("Tr", "Tr_velo_to_cam"):
            values = parse_numbers(rest.split(), place)
            if len(values) != 12:
                raise InputError(f"{place}: expected the 12 numbers of a 3x4 matrix, found {len(values)}")
            return pose_from_matrix(values, place)
    raise InputError(f"{path}: expected a line 'Tr:' (velodyne to camera), found none")


def _check_times(path: Path, num_poses: int) -> None:
    """A times.txt of another drive would go unnoticed otherwise; where there is none, nothing depends on it."""
    if not path.is_file():
        return
    num_times = len(path.read_text("utf-8").split())
    if num_times != num_poses:
        raise InputError(f"{path}: expected a time for each of the {num_poses} poses, found {num_times}")
