"""Pair lists of the benchmarks, from small folders in their layouts: who is paired, by which pose."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import suite_folders as folders

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.io.suites import SUITES, read_suite
from svc_ros.io.suites.kitti import LEFT_OUT
from svc_ros.io.suites.redwood_log import read_info, read_log
from svc_ros.io.suites.spacing import pair_by_distance


@pytest.fixture(scope="module")
def rooms(tmp_path_factory) -> Path:
    return folders.write_3dmatch(tmp_path_factory.mktemp("3dmatch"))


@pytest.fixture(scope="module")
def street(tmp_path_factory) -> Path:
    return folders.write_kitti(tmp_path_factory.mktemp("kitti"), exact=True)


@pytest.fixture
def own_rooms(rooms, tmp_path) -> Path:
    return Path(shutil.copytree(rooms, tmp_path / "own"))


@pytest.fixture
def own_street(street, tmp_path) -> Path:
    return Path(shutil.copytree(street, tmp_path / "own"))


def test_3dmatch_pairs_map_fragment_j_into_i(rooms):
    suite = read_suite("3dmatch", rooms)
    assert (suite.name, suite.preset, len(suite.pairs)) == ("3DMatch", "rgbd_indoor", 6)
    pair = suite.pairs[1]
    scene = folders.SCENES[0]
    assert (pair.source, pair.target) == (f"{scene}/cloud_bin_2.ply", f"{scene}/cloud_bin_0.ply")
    assert (pair.file_name, pair.group, pair.indices) == (f"{scene}/0_2", scene, (0, 2))
    np.testing.assert_allclose(pair.T_target_source, folders.pose_of(0, 2), atol=1e-9)
    source, target = (suite.read_scan(path).points for path in (pair.source, pair.target))
    world = [se3.apply(folders.FRAGMENT_POSES[k], points) for k, points in ((2, source), (0, target))]
    moved = se3.apply(folders.FRAGMENT_POSES[0], se3.apply(pair.T_target_source, source))
    np.testing.assert_allclose(moved, world[0], atol=1e-9)
    assert len(target) == len(world[1]) > 1000


def test_3dlomatch_has_a_list_of_its_own(tmp_path):
    root = folders.write_3dlomatch(tmp_path)
    low, high = read_suite("3dlomatch", root), read_suite("3dmatch", root)
    assert [pair.indices for pair in low.pairs] == [(0, 2), (1, 2)]
    assert [pair.indices for pair in high.pairs] == [(0, 1)]
    assert low.pairs[0].source == f"data/test/{folders.SCENES[0]}/cloud_bin_2.ply"


def test_evaluation_folders_beside_the_scenes_are_not_3dlomatch(rooms):
    with pytest.raises(InputError, match="expected the ground truth of 3DLoMatch in one of 3DLoMatch"):
        read_suite("3dlomatch", rooms)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("gt.log", lambda text: text.replace("0\t1\t3", "0\t1", 1), r"gt\.log:1: expected three whole numbers"),
        ("gt.log", lambda text: text.rsplit("\n", 2)[0], r"gt\.log:11: pair 1 2: expected 4 rows, found 3"),
        ("gt.log", lambda text: text.replace("0\t2\t3", "0\t1\t3"), r"gt\.log:6: pair 0 1 stands there twice"),
        ("gt.log", lambda text: text.replace("0.000000000000", "x", 1), r"gt\.log:\d: expected numbers"),
        ("gt.log", lambda text: text.replace("1.000000000000", "3.0"), r"gt\.log:1: pair 0 1: expected the last row"),
        ("gt.log", lambda text: "", r"gt\.log: expected blocks of a line 'i j n' and 4 rows, found none"),
        ("gt.info", lambda text: "\n".join(text.splitlines()[7:]), r"gt\.info: expected every pair .* no pair 0 1"),
        ("gt.info", lambda text: text.replace("\t", "\t1\t", 3), r"gt\.info:\d: expected"),
    ],
)
def test_broken_truth_is_told_with_file_and_line(own_rooms, name, change, message):
    path = own_rooms / f"{folders.SCENES[0]}-evaluation" / name
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=message):
        read_suite("3dmatch", own_rooms)


def test_information_counts_its_correspondences(own_rooms):
    path = own_rooms / f"{folders.SCENES[0]}-evaluation" / "gt.info"
    folders.write_blocks(path, {(0, 1): np.zeros((6, 6))})
    with pytest.raises(InputError, match=r"gt\.info:1: pair 0 1: expected a positive first entry, found 0"):
        read_info(path)


def test_blank_lines_and_blanks_instead_of_tabs_are_read(tmp_path):
    folders.write_blocks(tmp_path / "gt.log", {(3, 7): folders.pose_of(0, 1)})
    expected = read_log(tmp_path / "gt.log")
    (tmp_path / "gt.log").write_text((tmp_path / "gt.log").read_text().replace("\t", "   ").replace("\n", "\n\n"))
    assert list(read_log(tmp_path / "gt.log")) == [(3, 7)]
    np.testing.assert_array_equal(read_log(tmp_path / "gt.log")[3, 7], expected[3, 7])


def test_missing_fragments_are_told(own_rooms):
    scene = own_rooms / folders.SCENES[1]
    (scene / "cloud_bin_1.ply").rename(scene / "cloud_bin_1.pth")
    with pytest.raises(InputError, match=r"cloud_bin_1\.pth: expected one of .ply.*save the points of \.pth files as"):
        read_suite("3dmatch", own_rooms)
    (scene / "cloud_bin_1.pth").unlink()
    with pytest.raises(InputError, match=r"hotel3: expected cloud_bin_1 as one of .ply"):
        read_suite("3dmatch", own_rooms)
    shutil.rmtree(scene)
    with pytest.raises(InputError, match=r"expected the fragments of .*hotel3 in one of .*fragments/.*found none"):
        read_suite("3dmatch", own_rooms)


def test_the_10_m_protocol_takes_the_last_scan_before_10_m():
    x = np.array([0.0, 4.0, 8.0, 9.9, 10.1, 14.0, 18.0, 24.5, 26.0])
    positions = np.column_stack([x, np.zeros((len(x), 2))])
    # 0 -> 3 (10.1 is the first beyond), then from 4: 24.5 is the first beyond 20.1, so 6; then nothing is far enough
    assert pair_by_distance(positions) == [(0, 3), (4, 6)]


def test_a_jump_makes_no_pair_of_a_scan_with_itself():
    x = np.array([0.0, 50.0, 52.0, 59.9, 60.1])
    assert pair_by_distance(np.column_stack([x, np.zeros((5, 2))])) == [(1, 3)]


def test_partners_are_looked_for_within_the_window_only():
    x = np.concatenate([np.zeros(120), [20.0, 20.1]])
    positions = np.column_stack([x, np.zeros((len(x), 2))])
    assert pair_by_distance(positions) == [(21, 119)]


def test_kitti_pairs_are_10_m_apart_by_the_poses_of_the_velodyne(street):
    suite = read_suite("kitti", street)
    assert [pair.file_name for pair in suite.pairs] == ["8_0_4", "8_5_8"][: len(suite.pairs)]
    pair = suite.pairs[0]
    assert (pair.source, pair.target) == ("sequences/08/velodyne/000000.bin", "sequences/08/velodyne/000004.bin")
    scans = folders.drive()
    expected = se3.invert(scans[4].T_map_lidar) @ scans[0].T_map_lidar
    np.testing.assert_allclose(pair.T_target_source, expected, atol=1e-6)
    assert pair.distance_m == pytest.approx(4 * folders.SPACING_M, abs=0.1)
    assert suite.refined == street / "icp"
    assert read_suite("kitti", street, Path("elsewhere")).refined == Path("elsewhere")


def test_kitti_may_stand_in_its_dataset_folder_and_lack_scans(own_street):
    (own_street / "dataset").mkdir()
    for name in ("sequences", "poses"):
        (own_street / name).rename(own_street / "dataset" / name)
    (own_street / "dataset/sequences/08/velodyne/000000.bin").unlink()
    suite = read_suite("kitti", own_street)
    assert [pair.indices for pair in suite.pairs] == [(5, 1)]
    assert suite.pairs[0].source == "dataset/sequences/08/velodyne/000001.bin"


def test_the_pair_with_the_wrong_reference_is_left_out():
    assert {("08", 15, 58)} == LEFT_OUT


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("sequences/08/calib.txt", "P0: 1 2 3\n", r"calib\.txt: expected a line 'Tr:'"),
        ("sequences/08/calib.txt", "Tr: 1 2 3\n", r"calib\.txt:1: expected the 12 numbers"),
        ("sequences/08/times.txt", "0.0\n0.1\n", r"times\.txt: expected a time for each of the 9 poses, found 2"),
        ("poses/08.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", r"times\.txt: expected a time for each of the 1 poses, found 9"),
        ("poses/08.txt", "1 0 0\n", r"08\.txt:1: expected the 12 numbers"),
    ],
)
def test_broken_kitti_files_are_told(own_street, path, text, message):
    (own_street / path).write_text(text)
    with pytest.raises(InputError, match=message):
        read_suite("kitti", own_street)


def test_a_scan_without_pose_is_told(own_street):
    (own_street / "sequences/08/times.txt").unlink()
    (own_street / "poses/08.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(InputError, match=r"000008\.bin: expected a pose for each scan, found 1"):
        read_suite("kitti", own_street)


def test_mulran_poses_are_those_of_the_vehicle(tmp_path):
    mulran = se3.make_pose(np.diag([-1.0, -1.0, 1.0]), (1.7042, -0.021, 1.8047))
    turn = np.radians(179.6654)
    mulran[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    folders.write_mulran(tmp_path / "DCC01", mulran)
    suite = read_suite("mulran", tmp_path)
    scans = folders.drive()
    pair = suite.pairs[0]
    assert (pair.group, pair.source) == ("DCC01", "DCC01/Ouster/1560000000000000000.bin")
    expected = se3.invert(scans[4].T_map_lidar) @ scans[0].T_map_lidar
    np.testing.assert_allclose(pair.T_target_source, expected, atol=2e-4)
    alone = read_suite("mulran", tmp_path / "DCC01")
    assert [p.source for p in alone.pairs] == [p.source.removeprefix("DCC01/") for p in suite.pairs]


def test_another_mounting_is_read_from_its_file(tmp_path):
    mounting = se3.make_pose(np.eye(3), (1.0, 2.0, 3.0))
    folders.write_mulran(tmp_path, mounting)
    np.savetxt(tmp_path / "base_to_ouster.txt", mounting)
    scans = folders.drive()
    expected = se3.invert(scans[4].T_map_lidar) @ scans[0].T_map_lidar
    np.testing.assert_allclose(read_suite("mulran", tmp_path).pairs[0].T_target_source, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n", r"global_pose\.csv:1: expected a stamp \[ns\] and 12 numbers, found 1,2,3"),
        ("\n", r"global_pose\.csv: expected lines of a stamp"),
        ("5,1,0,0,0,0,1,0,0,0,0,1,0\n", r"expected scans within the time of global_pose\.csv, found none of 10"),
    ],
)
def test_broken_mulran_poses_are_told(tmp_path, text, message):
    folders.write_mulran(tmp_path, np.eye(4))
    (tmp_path / "global_pose.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_suite("mulran", tmp_path)


@pytest.mark.parametrize("name", SUITES)
def test_a_folder_with_another_layout_is_told(tmp_path, name):
    with pytest.raises(InputError, match=r"^.*: expected .*, found none"):
        read_suite(name, tmp_path)
    with pytest.raises(InputError, match="expected a folder, found nothing"):
        read_suite(name, tmp_path / "nowhere")


def test_an_unknown_suite_is_told_with_the_nearest_name(tmp_path):
    with pytest.raises(InputError, match=r"3dmach.*3dmatch"):
        read_suite("3dmach", tmp_path)
