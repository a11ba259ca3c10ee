"""`svc_ros evaluate` on small benchmarks in their own layouts, from the command line to the JSON."""

from __future__ import annotations

import json
from pathlib import Path

import dask_processes
import numpy as np
import pair_list_folders as lists
import pytest
import suite_folders as folders
from mini_data import POSES, pose_between, scan_room, without_times, write_dataset
from places import PROJECT_ROOT
from typer.testing import CliRunner

from svc_ros.cli.main import app
from svc_ros.core import se3
from svc_ros.evaluation import suite_reference
from svc_ros.io.correspondence_files import write_correspondences


@pytest.fixture(scope="module")
def rooms(tmp_path_factory) -> Path:
    return folders.write_3dmatch(tmp_path_factory.mktemp("3dmatch"))


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("own") / "room")


def run(*words: str | Path, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["evaluate", *map(str, words)])
    assert result.exit_code == code, result.output
    return result.stderr if code else result.stdout


def report_of(*words: str | Path) -> dict:
    return json.loads(run(*words, "--json", "-"))


def test_3dmatch_has_both_recalls_and_every_scene(rooms):
    report = report_of(rooms, "--suite", "3dmatch", "--preset", "lidar_indoor")
    assert (report["dataset"], report["preset"], report["registration"]["num_pairs"]) == ("3DMatch", "lidar_indoor", 6)
    errors, rmse = report["recall"]["15 deg, 0.3 m"], report["recall"]["rmse 0.2 m, not consecutive"]
    assert (errors["num_pairs"], errors["recall"], errors["recall_mean_over_groups"]) == (6, 1.0, 1.0)
    assert (rmse["num_pairs"], rmse["recall"]) == (2, 1.0)
    assert list(errors["groups"]) == list(folders.SCENES)
    row = report["registration"]["pairs"][1]
    assert row["name"] == f"{folders.SCENES[0]}/0_2"
    assert row["rmse_m"] < 0.05
    assert se3.pose_error(row["best_candidate"], folders.pose_of(0, 2))[1] == pytest.approx(row["translation_error_m"])


def test_3dlomatch_and_mulran_run_from_the_command_line(tmp_path):
    folders.write_3dlomatch(tmp_path / "lo")
    text = run(tmp_path / "lo", "--suite", "3dlomatch", "--preset", "lidar_indoor", "--method", "sc2")
    assert "recall (rmse 0.2 m, not consecutive)" in text
    folders.write_mulran(tmp_path / "DCC01", np.eye(4))
    np.savetxt(tmp_path / "DCC01" / "base_to_ouster.txt", np.eye(4))
    report = report_of(tmp_path / "DCC01", "--suite", "mulran", "--limit", "1", "--method", "sc2")
    assert report["recall"]["5 deg, 2 m"]["num_pairs"] == 1
    assert (tmp_path / "DCC01" / "icp").is_dir()


def test_kitti_is_measured_against_refined_references(tmp_path):
    folders.write_kitti(tmp_path / "kitti")
    report = report_of(tmp_path / "kitti", "--suite", "kitti", "--refined", tmp_path / "cache", "--limit", "1")
    (row,) = report["registration"]["pairs"]
    assert (row["name"], row["verdict"], row["group"], row["rmse_m"]) == ("8_0_4", "accepted", "08", None)
    assert {"5 deg, 0.6 m", "5 deg, 2 m"} == set(report["recall"])
    assert report["recall"]["5 deg, 0.6 m"]["recall"] == 1.0
    refined = np.load(tmp_path / "cache" / "8_0_4.npy")
    assert se3.pose_error(row["best_candidate"], refined)[1] == pytest.approx(row["translation_error_m"], abs=1e-9)
    assert not (tmp_path / "kitti" / "icp").exists()


def test_loop_closures_are_measured_by_range(tmp_path):
    street = lists.write_street(tmp_path)
    report = report_of(street, "--suite", "kitti-loops", "--limit", "2")
    recall = report["recall"]["5 deg, 2 m"]
    assert {name: group["num_pairs"] for name, group in recall["groups"].items()} == {"0-10 m": 1, "10-20 m": 1}
    assert (recall["recall"], recall["recall_mean_over_groups"]) == (1.0, 1.0)
    assert not (street / "icp").exists()


def test_nuscenes_is_measured_as_it_is_distributed(tmp_path):
    root = lists.write_arrays(lists.write_nuscenes(tmp_path), "lonuscenes", [(lists.LOG, 0, 4)])
    text = run(root, "--suite", "lonuscenes")
    assert "LoNuScenes: method svc, preset lidar_outdoor" in text
    assert "recall (1 deg, 0.1 m)" in text
    assert "recall 0-10 m" in text


def test_given_correspondences_take_the_place_of_descriptors(room, tmp_path):
    """Right ones find the pose at once; wrong ones, of another pose, lead away from it."""
    points = scan_room(POSES[1], seed=1)[::20]
    wrong = se3.make_pose(np.eye(3), (3.0, -2.0, 0.0))
    for name, T in (("right", pose_between(1, 0)), ("wrong", wrong)):
        for pair in ("1_0", "few_0"):
            write_correspondences(tmp_path / name / f"{pair}.npz", points, se3.apply(T, points))
    found = {}
    for name in ("right", "wrong"):
        report = report_of(room, "--correspondences", tmp_path / name, "--limit", "1", "--method", "sc2")
        found[name] = report["registration"]["pairs"][0]
        assert "matching" not in report["time_ms"]["stages_p50"]
    assert found["right"]["translation_error_m"] < 1e-6
    assert found["wrong"]["translation_error_m"] > 1.0


def test_a_pair_without_its_correspondences_is_told_by_name(room, tmp_path):
    text = run(room, "--correspondences", tmp_path, code=2)
    assert "room: pair scans/1.bin -> scans/0.bin:" in text
    assert "1_0.npz: no such file of correspondences" in text
    assert "expected a folder of .npz files" in run(room, "--correspondences", tmp_path / "gone", code=2)


def test_several_sets_have_one_report_each_and_a_total(room, rooms, tmp_path):
    one = report_of(room)
    several = report_of(room, room)
    assert without_times(several)["datasets"] == [without_times(one)] * 2
    assert several["total"] == {
        "num_pairs": 6, "num_accepted": 4, "num_correct_accepted": 4, "num_false_accepted": 0,
        "success_rate": pytest.approx(2 / 3), "candidate_success_rate": pytest.approx(2 / 3),
        "num_negatives": 2, "num_false_accepted_negatives": 0,
    }  # fmt: skip
    assert "all together" in run(room, room, "--limit", "1", "--method", "sc2")


@pytest.mark.slow
def test_dask_gives_the_reports_of_the_serial_run(room, rooms, tmp_path):
    pytest.importorskip("distributed")
    with dask_processes.cluster(tmp_path) as found:
        spread = report_of(room, room, "--scheduler", found.address)
        suite = report_of(rooms, "--suite", "3dmatch", "--method", "sc2", "--scheduler", found.address)
        missing = run(tmp_path / "gone", "--scheduler", found.address, code=2)
    assert without_times(spread) == without_times(report_of(room, room))
    assert without_times(suite) == without_times(report_of(rooms, "--suite", "3dmatch", "--method", "sc2"))
    assert "expected a dataset folder, found nothing" in missing


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--suite", "3dmatch"], "expected the ground truth of 3DMatch in one of"),
        (["--suite", "kiti"], "did you mean 'kitti'"),
        (["--scheduler", "host"], "expected 'local' or an address such as tcp://host:8786, found 'host'"),
    ],
)
def test_wrong_words_are_told_in_one_line(room, words, message):
    text = run(room, *words, code=2)
    assert message in text
    assert text.count("\n") == 1


def test_the_page_tells_every_suite_definition_and_key():
    from svc_ros.io import correspondence_files
    from svc_ros.io.suites import SUITES, kitti, kitti_lists, pair_list, threedmatch

    page = (PROJECT_ROOT / "docs" / "benchmarks.md").read_text("utf-8")
    keys = [key for pair in correspondence_files._KEYS for key in pair]
    criteria = (*kitti.CRITERIA, *threedmatch.CRITERIA, *kitti_lists.LOOP_CRITERIA, *kitti_lists.ROTATED_CRITERIA)
    names = [c.name for c in (*criteria, *kitti_lists.LOW_OVERLAP_CRITERIA)]
    files = (*kitti_lists.LOOP_RANGES.values(), kitti_lists.LIST_OF_GCL)
    places = [f"{folder}/" for folder in (*kitti_lists.LOOP_FOLDERS, *pair_list.ARRAY_FOLDERS) if folder]
    told = (*SUITES, *names, *keys, *files, *places, "distance", "corr_scores")
    assert [name for name in told if f"`{name}`" not in page] == []
    assert f"{kitti_lists.MAX_DISTANCE_M:g} m apart" in page
    assert f"{suite_reference.VOXEL_SIZE_M} m grid, pairs within {suite_reference.MAX_DISTANCE_M} m" in page


def test_the_help_names_every_suite():
    from svc_ros.cli.evaluate import SuiteOption
    from svc_ros.io.suites import SUITES

    help_text = SuiteOption.__metadata__[0].help
    assert sorted(help_text.removeprefix("Layout of DIR: ").removesuffix(".").split(", ")) == sorted(SUITES)


def test_workers_and_scheduler_exclude_each_other(room):
    assert "either --workers or --scheduler" in run(room, "--workers", "2", "--scheduler", "local", code=2)
