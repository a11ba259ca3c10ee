"""Published pair lists: loop closures of KITTI, LoKITTI, RotKITTI, LoNuScenes and RotNuScenes, in their layouts."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pair_list_folders as lists
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.io.suites import read_suite
from svc_ros.io.suites.pair_list import angle_range, distance_range

NUMBERS = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"


@pytest.fixture(scope="module")
def shared_street(tmp_path_factory) -> Path:
    return lists.write_street(tmp_path_factory.mktemp("street"))


@pytest.fixture(scope="module")
def shared_nuscenes(tmp_path_factory) -> Path:
    return lists.write_nuscenes(tmp_path_factory.mktemp("nuscenes"))


@pytest.fixture
def street(shared_street, tmp_path) -> Path:
    return Path(shutil.copytree(shared_street, tmp_path / "own"))


@pytest.fixture
def nuscenes(shared_nuscenes, tmp_path) -> Path:
    return Path(shutil.copytree(shared_nuscenes, tmp_path / "own"))


def assert_aligned(suite, pair) -> None:
    """The reference lays most of the source's points onto the target's surfaces."""
    from scipy.spatial import cKDTree

    source, target = (suite.read_scan(path).points for path in (pair.source, pair.target))
    near = np.linalg.norm(source, axis=1) < 15.0
    distance, _ = cKDTree(target).query(se3.apply(pair.T_target_source, source[near]))
    assert np.median(distance) < 0.3


def turned(degrees: float, metres: float) -> np.ndarray:
    return se3.make_pose(Rotation.from_euler("z", degrees, degrees=True).as_matrix(), (metres, 0.0, 0.0))


def test_loop_closures_come_by_range_with_the_poses_of_the_list(street):
    suite = read_suite("kitti-loops", street)
    assert [(p.file_name, p.group, p.overlap) for p in suite.pairs] == [
        ("8_0_4", "0-10 m", None), ("8_0_6", "10-20 m", 0.5), ("8_8_1", "10-20 m", 0.5)
    ]  # fmt: skip
    pair = suite.pairs[2]
    assert (pair.source, pair.target) == ("sequences/08/velodyne/000008.bin", "sequences/08/velodyne/000001.bin")
    assert pair.indices == (1, 8)
    np.testing.assert_allclose(pair.T_target_source, lists.pose_between(8, 1), atol=1e-5)
    assert_aligned(suite, suite.pairs[1])
    assert ([c.name for c in suite.criteria], suite.refined) == (["5 deg, 2 m"], None)


@pytest.mark.parametrize("place", [".", "benchmarks/kitti_lc", "configs/datasets/kitti_lc"])
def test_lists_may_stand_where_their_repositories_have_them(street, place):
    (street / place).mkdir(parents=True, exist_ok=True)
    (street / "kitti_lc/test_10_20.txt").rename(street / place / "test_10_20.txt")
    shutil.rmtree(street / "kitti_lc")
    (street / "dataset").mkdir()
    (street / "sequences").rename(street / "dataset/sequences")
    suite = read_suite("kitti-loops", street)
    assert [pair.group for pair in suite.pairs] == ["10-20 m"] * 2
    assert suite.pairs[0].source == "dataset/sequences/08/velodyne/000000.bin"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("8 0 8 4 1 0 0", r"test_0_10\.txt:2: expected seq i seq_db j and the 16 numbers .*, found 7 values"),
        (f"8 0 8 -4 {NUMBERS}", r":2: expected four whole numbers 'seq i seq_db j', found 8 0 8 -4"),
        (f"8 0 7 4 {NUMBERS}", r":2: expected both scans in one sequence, found 8 and 7"),
        (f"8 0 8 4 2{NUMBERS[1:]}", r":2: its upper left 3x3 block is not a rotation"),
        (f"8 0 8 4 x{NUMBERS[1:]}", r":2: expected numbers"),
        (f"8 0 8 99 {NUMBERS}", r":2: expected the scan .*000099\.bin, found none"),
        ("", r"test_0_10\.txt: expected lines of seq i seq_db j .*, found none"),
    ],
)
def test_broken_lines_are_told_with_file_and_line(street, line, message):
    (street / "kitti_lc/test_0_10.txt").write_text(f"{lists.HEADING}\n{line}\n")
    with pytest.raises(InputError, match=message):
        read_suite("kitti-loops", street)


def test_missing_lists_and_missing_sequences_are_told(street):
    with pytest.raises(InputError, match=r"expected the pair list in one of rotkitti_metadata\.npy, metadata/.*none"):
        read_suite("rotkitti", street)
    (street / "sequences/08").rename(street / "sequences/03")
    with pytest.raises(InputError, match="expected the scans of a sequence that the pair list names, found none"):
        read_suite("kitti-loops", street)


def test_lokitti_takes_the_poses_beside_its_list(street):
    rows, poses = [(8, 0, 8), (8, 2, 3), (9, 0, 4), (8, 0, 4)], [turned(5, 12), turned(5, 51), np.eye(4), turned(5, 4)]
    lists.write_arrays(street / "metadata", "lokitti", rows, poses)
    suite = read_suite("lokitti", street)
    assert [(p.file_name, p.group) for p in suite.pairs] == [("8_0_4", "0-10 m"), ("8_0_8", "10-20 m")]
    np.testing.assert_allclose(suite.pairs[1].T_target_source, poses[0], atol=1e-12)
    assert [c.name for c in suite.criteria] == ["5 deg, 2 m", "1.5 deg, 0.3 m", "1 deg, 0.1 m"]
    assert (suite.success.rotation_deg, suite.success.translation_m) == (5.0, 2.0)


@pytest.mark.parametrize("name", ["lokitti_metadata.npy", "file_LoKITTI_50.npy"])
def test_a_list_without_poses_is_read_with_those_of_semantickitti(street, name):
    np.save(street / name, np.array([(8, 0, 4), (8, 7, 2)]))
    lists.write_semantic_poses(street)
    if name.startswith("file"):  # poses of another list are none of its own
        np.save(street / "lokitti_gt_tforms.npy", np.stack([turned(90, 5)] * 2))
    suite = read_suite("lokitti", street)
    np.testing.assert_allclose(suite.pairs[0].T_target_source, lists.pose_between(0, 4), atol=1e-6)
    assert_aligned(suite, suite.pairs[0])
    np.save(street / name, np.array([(8, 0, 9)]))
    (street / "lokitti_gt_tforms.npy").unlink(missing_ok=True)
    with pytest.raises(InputError, match=rf"{name}: row 0: expected frames below 9, .*poses\.txt, found 9"):
        read_suite("lokitti", street)


def test_rotkitti_comes_by_angle(street):
    poses = [turned(175, 3), turned(-45, 8), turned(180, 0), turned(59, 2)]
    lists.write_arrays(street, "rotkitti", [(8, k, k + 1) for k in range(4)], poses)
    suite = read_suite("rotkitti", street)
    assert [(p.indices[1], p.group) for p in suite.pairs] == [
        (1, "30-60 deg"), (3, "30-60 deg"), (0, "150-180 deg"), (2, "150-180 deg")
    ]  # fmt: skip
    assert [c.name for c in suite.criteria][:2] == ["1.5 deg, 0.3 m", "1 deg, 0.1 m"]


def test_ranges_begin_with_their_lower_bound():
    assert [distance_range(turned(0, d)) for d in (0.0, 9.99, 10.0, 49.0)] == ["0-10 m", "0-10 m", "10-20 m", "40-50 m"]
    assert [angle_range(turned(a, 1)) for a in (0, 31, 121, 180)] == [
        "0-30 deg", "30-60 deg", "120-150 deg", "150-180 deg"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rows", "poses", "message"),
    [
        (np.zeros((2, 2), int), None, r"metadata\.npy: expected rows of sequence, source, target .*shape \(2, 2\)"),
        (np.zeros((2, 3)), None, r"metadata\.npy: expected rows .*found float64 of shape \(2, 3\)"),
        (np.array([(8, 0, 1), (8, -1, 2)]), None, r"metadata\.npy: row 1: expected .* two frames, found 8 -1 2"),
        (np.array([("x", "0", "1")]), None, r"metadata\.npy: row 0: expected the number of a sequence, found x"),
        (np.array([(8, 0, 1)], object), None, r"metadata\.npy: expected a \.npy array .*pickles are never loaded"),
        (np.array([(8, 0, 1)]), np.zeros((2, 4, 4)), r"gt_tforms\.npy: expected a 4x4 matrix for each of the 1 pairs"),
        (np.array([(8, 0, 1)]), np.zeros((1, 4, 4)), r"metadata\.npy: row 0: its pose: expected the last row 0 0 0 1"),
        (np.array([(8, 0, 1)]), None, r"sequences/08/poses\.txt: cannot be read"),
    ],
)  # fmt: skip
def test_broken_arrays_are_told_with_file_and_row(street, rows, poses, message):
    np.save(street / "rotkitti_metadata.npy", rows)
    if poses is not None:
        np.save(street / "rotkitti_gt_tforms.npy", poses)
    with pytest.raises(InputError, match=message):
        read_suite("rotkitti", street)


def test_nuscenes_and_its_export_give_the_same_pairs(nuscenes, tmp_path):
    """References of lists are in the axes of the export: turned for nuScenes' own scans, taken as they are for it."""
    export = lists.write_export(tmp_path / "export")
    rows = [(lists.LOG, 0, 5), (lists.LOG, 3, 2), (lists.OTHER_LOG, 0, 0)]
    true = [lists.pose_between(1, 6), lists.pose_between(4, 3), np.eye(4)]
    of_list = [se3.invert(lists.T_SCAN_EXPORT) @ T @ lists.T_SCAN_EXPORT for T in true]
    for poses in (None, of_list):
        for root in (nuscenes, export):
            lists.write_arrays(root, "lonuscenes", rows, poses)
        raw, turned_axes = read_suite("lonuscenes", nuscenes), read_suite("lonuscenes", export)
        order = {f"{lists.LOG}/3_2": 1, f"{lists.OTHER_LOG}/0_0": 2, f"{lists.LOG}/0_5": 0}
        for suite, expected in ((raw, true), (turned_axes, of_list)):
            assert [p.file_name for p in suite.pairs] == list(order)
            for pair in suite.pairs:
                np.testing.assert_allclose(pair.T_target_source, expected[order[pair.file_name]], atol=1e-9)
            assert_aligned(suite, suite.pairs[2])
    assert [p.group for p in raw.pairs] == ["0-10 m", "0-10 m", "10-20 m"]
    assert raw.pairs[2].source.endswith("__1.pcd.bin")
    assert turned_axes.pairs[2].source == f"test/sequences/{lists.LOG}/velodyne/000000.bin"


def test_rotnuscenes_comes_by_angle(nuscenes):
    lists.write_arrays(nuscenes / "metadata", "rotnuscenes", [(lists.LOG, 0, 1)], [turned(100, 3)])
    suite = read_suite("rotnuscenes", nuscenes)
    assert [(p.group, p.distance_m) for p in suite.pairs] == [("90-120 deg", pytest.approx(3.0))]
    assert suite.criteria[0].name == "1.5 deg, 0.3 m"


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("log", None, r"log\.json: cannot be read"),
        ("log", lambda rows: [{"logfile": "a"}], r"log\.json: expected a list of objects, each with its token"),
        ("log", lambda rows: rows[:1], r"log\.json: expected logfile of token 'l1', found none"),
        ("sample_data", lambda rows: rows[3:], r"sample_data\.json: expected a keyframe of LIDAR_TOP for sample"),
        ("ego_pose", lambda rows: rows[:3], r"ego_pose\.json: expected translation of token 'scan1', found none"),
        ("calibrated_sensor", lambda rows: [rows[0] | {"rotation": [1, 0, 0]}, rows[1]], r"token c0: expected a tran"),
        ("calibrated_sensor", lambda rows: [rows[0] | {"rotation": [1, 1, 0, 0]}, rows[1]], r"quaternion of length 1"),
        ("sample", lambda rows: rows[:4], r"metadata\.npy: row 0: expected frames below 3, .*ego_pose\.json, found 7"),
        ("sample", lambda rows: rows[:1], rf"row 0: expected the keyframes of {lists.LOG} in .*, found none"),
    ],
)  # fmt: skip
def test_broken_tables_are_told(nuscenes, table, change, message):
    lists.write_arrays(nuscenes, "lonuscenes", [(lists.LOG, 0, 7), (lists.OTHER_LOG, 0, 0)])
    path = nuscenes / "v1.0-test" / f"{table}.json"
    if change is None:
        path.unlink()
    else:
        path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(InputError, match=message):
        read_suite("lonuscenes", nuscenes)


def test_other_broken_nuscenes_folders_are_told(nuscenes, tmp_path):
    lists.write_arrays(tmp_path, "lonuscenes", [(lists.LOG, 0, 7)])
    with pytest.raises(InputError, match=r"expected v1\.0-test/\*\.json or test/sequences/LOG/velodyne.*, found none"):
        read_suite("lonuscenes", tmp_path)
    export = lists.write_export(tmp_path / "export")
    lists.write_arrays(export, "lonuscenes", [(lists.LOG, 0, 7)])
    np.save(export / "test/sequences" / lists.LOG / "poses.npy", np.zeros((8, 4, 4)))
    with pytest.raises(InputError, match=r"poses\.npy: row 0: expected the last row 0 0 0 1"):
        read_suite("lonuscenes", export)
    np.save(export / "test/sequences" / lists.LOG / "poses.npy", np.zeros((8, 12)))
    with pytest.raises(InputError, match=r"poses\.npy: expected 4x4 matrices, found float64 of shape \(8, 12\)"):
        read_suite("lonuscenes", export)
