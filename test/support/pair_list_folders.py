"""Small folders as benchmarks with published pair lists lay them out: KITTI drives, nuScenes and its export."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import suite_folders as folders
from mini_data import write_bin
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.scan import Array

HEADING = "seq i seq_db j " + " ".join(f"mot{k}" for k in range(1, 16))
# The first scan of the drive is the only keyframe of another log.
LOG, OTHER_LOG = "n008-2018-08-01-15-16-36-0400", "n015-2018-07-24-11-22-45+0800"
T_EGO_LIDAR = se3.make_pose(Rotation.from_euler("z", -90.0, degrees=True).as_matrix(), (0.94, 0.0, 1.84))
T_SCAN_EXPORT = se3.make_pose(Rotation.from_euler("z", 90.0, degrees=True).as_matrix(), np.zeros(3))


def pose_between(source: int, target: int) -> Array:
    """T_target_source of two scans of the drive."""
    scans = folders.drive()
    return se3.invert(scans[target].T_map_lidar) @ scans[source].T_map_lidar


def write_loops(folder: Path, name: str, rows: Sequence[tuple[int, int, int, Array]], tail: str = "") -> Path:
    """A text list: sequence, source, target, pose; six digits, as published."""
    lines = [HEADING]
    for sequence, i, j, T in rows:
        lines.append(f"{sequence} {i} {sequence} {j} " + " ".join(f"{value:.6f}" for value in T.ravel()) + tail)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder / name


def write_street(root: Path) -> Path:
    """Sequence 08 without KITTI's poses, loop closures in two ranges, one of them in a sequence that is not there."""
    folders.write_kitti(root, exact=True)
    shutil.rmtree(root / "poses")
    lists = root / "kitti_lc"
    write_loops(lists, "test_0_10.txt", [(0, 1, 900, np.eye(4)), (8, 0, 4, pose_between(0, 4))])
    write_loops(lists, "test_10_20.txt", [(8, 0, 6, pose_between(0, 6)), (8, 8, 1, pose_between(8, 1))], " 0.5")
    return root


def write_semantic_poses(root: Path) -> None:
    """SemanticKITTI's poses.txt of sequence 08: camera 0 in its first frame."""
    cameras = [scan.T_map_lidar @ se3.invert(folders.T_CAMERA_VELODYNE) for scan in folders.drive()]
    rows = [(se3.invert(cameras[0]) @ T)[:3].ravel() for T in cameras]
    np.savetxt(root / "sequences" / "08" / "poses.txt", rows)


def write_arrays(folder: Path, name: str, rows: Sequence[Sequence[Any]], poses: Sequence[Array] | None = None) -> Path:
    """NAME_metadata.npy and, where poses are given, NAME_gt_tforms.npy."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / f"{name}_metadata.npy", np.array(rows))
    if poses is not None:
        np.save(folder / f"{name}_gt_tforms.npy", np.stack(poses))
    return folder


def write_export(root: Path) -> Path:
    """What export_kitti_minimal.py makes of `write_nuscenes`: axes turned, four columns, keyframes counted a log."""
    for log, scans in ((LOG, folders.drive()[1:]), (OTHER_LOG, folders.drive()[:1])):
        folder = root / "test" / "sequences" / log
        (folder / "velodyne").mkdir(parents=True)
        for k, scan in enumerate(scans):
            points = se3.apply(se3.invert(T_SCAN_EXPORT), scan.cast.points)
            write_bin(folder / "velodyne" / f"{k:06d}.bin", points)
        np.save(folder / "poses.npy", np.stack([scan.T_map_lidar @ T_SCAN_EXPORT for scan in scans]))
    return root


def write_nuscenes(root: Path) -> Path:
    """Tables of v1.0-test and scans of five columns; each sample has a camera's picture and a sweep between, too."""
    tables: dict[str, list[dict[str, Any]]] = {
        "log": [{"token": "l0", "logfile": OTHER_LOG}, {"token": "l1", "logfile": LOG}],
        "scene": [{"token": "s0", "log_token": "l0"}, {"token": "s1", "log_token": "l1"}],
        "sensor": [{"token": "lidar", "channel": "LIDAR_TOP"}, {"token": "camera", "channel": "CAM_FRONT"}],
        "calibrated_sensor": [
            {"token": "c0", "sensor_token": "lidar"} | _pose_of(T_EGO_LIDAR),
            {"token": "c1", "sensor_token": "camera"} | _pose_of(np.eye(4)),
        ],
        "sample": [], "sample_data": [], "ego_pose": [],
    }  # fmt: skip
    (root / "samples" / "LIDAR_TOP").mkdir(parents=True)
    for k, scan in enumerate(folders.drive()):
        tables["sample"].append({"token": f"sample{k}", "scene_token": "s0" if k == 0 else "s1"})
        ego = scan.T_map_lidar @ se3.invert(T_EGO_LIDAR)
        for kind, pose in (("scan", ego), ("picture", np.eye(4)), ("sweep", np.eye(4))):
            tables["ego_pose"].append({"token": f"{kind}{k}"} | _pose_of(pose))
            tables["sample_data"].append(
                {
                    "token": f"{kind}{k}", "sample_token": f"sample{k}", "ego_pose_token": f"{kind}{k}",
                    "calibrated_sensor_token": "c1" if kind == "picture" else "c0", "is_key_frame": kind != "sweep",
                    "filename": f"samples/LIDAR_TOP/{LOG}__LIDAR_TOP__{k}.pcd.bin",
                }
            )  # fmt: skip
        points = np.column_stack([scan.cast.points, np.full((len(scan.cast.points), 2), 3.0)])
        points.astype("<f4").tofile(root / tables["sample_data"][-1]["filename"])
    write_tables(root / "v1.0-test", tables)
    return root


def write_tables(folder: Path, tables: Mapping[str, Any]) -> None:
    """One JSON a table."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows))


def _pose_of(T: Array) -> dict[str, list[float]]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"translation": T[:3, 3].tolist(), "rotation": [w, x, y, z]}
