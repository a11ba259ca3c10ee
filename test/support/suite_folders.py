"""Small benchmarks in the layouts of the real ones: a furnished room as RGB-D scenes, a simulated street as drives."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from mini_data import scan_room, sensor_pose, write_bin

from svc_ros.core import se3
from svc_ros.core.scan import Array
from svc_ros.simulation.drive import DriveConfig, SimulatedScan, drive_scans

SCENES = ("7-scenes-redkitchen", "sun3d-hotel_umd-maryland_hotel3")
FRAGMENT_POSES = [sensor_pose(0.0, 0.0, 0.0), sensor_pose(0.8, 0.4, 25.0), sensor_pose(1.2, 1.0, -40.0)]
PAIRS = ((0, 1), (0, 2), (1, 2))  # the first and the last are consecutive
T_CAMERA_VELODYNE = se3.make_pose(
    [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], (0.0, -0.08, -0.27)
)
SPACING_M, NUM_SCANS = 2.4, 9


def information_of(points: Array) -> Array:
    """Information matrix (6, 6) as gt.info has it, of correspondences at these points (N, 3) of the source."""
    total = np.zeros((6, 6))
    for x, y, z in points:
        J = np.hstack([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]])
        total += J.T @ J
    return total


def write_ply(path: Path, points: Array) -> None:
    """Binary, float32 x y z, as the fragments are distributed."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def write_blocks(path: Path, blocks: dict[tuple[int, int], Array], num: int = 3) -> None:
    """gt.log or gt.info: tabs between the numbers."""
    lines = []
    for (i, j), matrix in blocks.items():
        lines.append(f"{i}\t{j}\t{num}")
        lines += ["\t".join(f"{value:.12f}" for value in row) for row in matrix]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def pose_of(i: int, j: int) -> Array:
    """T_i_j: what gt.log holds for the pair i j."""
    return se3.invert(FRAGMENT_POSES[i]) @ FRAGMENT_POSES[j]


def write_fragments(folder: Path) -> Path:
    """cloud_bin_0.ply ... of one scene."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, T in enumerate(FRAGMENT_POSES):
        write_ply(folder / f"cloud_bin_{k}.ply", scan_room(T, seed=k))
    return folder


def write_truth(folder: Path, pairs: tuple[tuple[int, int], ...] = PAIRS) -> Path:
    """gt.log and gt.info of one scene."""
    write_blocks(folder / "gt.log", {pair: pose_of(*pair) for pair in pairs})
    points = scan_room(FRAGMENT_POSES[0])[::50]
    write_blocks(folder / "gt.info", {pair: information_of(points) for pair in pairs})
    return folder


def write_3dmatch(root: Path) -> Path:
    """The layout of the geometric registration benchmark: SCENE/ beside SCENE-evaluation/."""
    for scene in SCENES:
        write_fragments(root / scene)
        write_truth(root / f"{scene}-evaluation")
    return root


def write_3dlomatch(root: Path) -> Path:
    """The layout of the repositories that brought 3DLoMatch; only one scene has pairs."""
    write_fragments(root / "data" / "test" / SCENES[0])
    write_truth(root / "benchmarks" / "3DLoMatch" / SCENES[0], ((0, 2), (1, 2)))
    write_truth(root / "benchmarks" / "3DMatch" / SCENES[0], ((0, 1),))
    return root


@lru_cache(maxsize=1)
def drive() -> tuple[SimulatedScan, ...]:
    """A street, a scan every 2.4 m: 19 m in all."""
    return tuple(drive_scans(DriveConfig(num_scans=NUM_SCANS, spacing_m=SPACING_M, seed=3)))


def positioning_error(k: int) -> Array:
    """What a positioning system is off by at scan k: up to 5 cm."""
    return se3.make_pose(np.eye(3), (0.05 * np.sin(2.0 * k), 0.05 * np.cos(3.0 * k), 0.0))


def write_kitti(root: Path, sequence: str = "08", exact: bool = False) -> Path:
    """One sequence: velodyne scans, calib.txt, times.txt, poses of camera 0 in its first frame."""
    folder = root / "sequences" / sequence
    (folder / "velodyne").mkdir(parents=True)
    cameras = []
    for k, scan in enumerate(drive()):
        write_bin(folder / "velodyne" / f"{k:06d}.bin", scan.cast.points)
        told = scan.T_map_lidar if exact else scan.T_map_lidar @ positioning_error(k)
        cameras.append(told @ se3.invert(T_CAMERA_VELODYNE))
    cameras = [se3.invert(cameras[0]) @ T for T in cameras]
    (root / "poses").mkdir(exist_ok=True)
    (root / "poses" / f"{sequence}.txt").write_text("".join(_row(T) + "\n" for T in cameras))
    (folder / "times.txt").write_text("".join(f"{0.1 * k:e}\n" for k in range(len(cameras))))
    camera = "7.2e+02 0 6.1e+02 0 0 7.2e+02 1.9e+02 0 0 0 1 0"
    (folder / "calib.txt").write_text(f"P0: {camera}\nP1: {camera}\nTr: {_row(T_CAMERA_VELODYNE)}\n")
    return root


def write_mulran(folder: Path, T_base_scanner: Array) -> Path:
    """One sequence: Ouster scans by stamp, poses of the vehicle at twice the rate, the first scan before them."""
    (folder / "Ouster").mkdir(parents=True)
    rows = []
    for k, scan in enumerate(drive()):
        stamp = 1_560_000_000_000_000_000 + 100_000_000 * k
        write_bin(folder / "Ouster" / f"{stamp}.bin", scan.cast.points)
        T = scan.T_map_lidar @ se3.invert(T_base_scanner)
        T[:3, 3] += (350_000.0, 4_000_000.0, 20.0)  # as UTM coordinates are
        rows.append(f"{stamp},{_row(T).replace(' ', ',')}")
    (folder / "global_pose.csv").write_text("\n".join(rows) + "\n")
    write_bin(folder / "Ouster" / "1559999990000000000.bin", drive()[0].cast.points)
    return folder


def _row(T: Array) -> str:
    return " ".join(f"{value:.12e}" for value in T[:3].ravel())
