"""The scripts of the paper's tables and figures, on a small room in place of the recordings."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import suite_folders as folders
from mini_data import POSES, pose_between, scan_room, write_dataset

from svc_ros.core import se3

pytestmark = pytest.mark.usefixtures("scripts")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """pairs/rgbd_redkitchen (the room: two pairs), pairs/hdl64_kitti_negatives, correspondences/kitti_10m_fpfh."""
    root = tmp_path_factory.mktemp("shared")
    (root / "pairs").mkdir()
    for name in ("rgbd_redkitchen", "hdl64_kitti_negatives"):
        path = write_dataset(root / "pairs" / name) / "dataset.json"
        content = json.loads(path.read_text())
        away = {"source": "scans/2.bin", "target": "scans/0.bin"}
        if name == "rgbd_redkitchen":
            content |= {"name": name, "pairs": content["pairs"][:2], "negatives": []}
        else:
            content |= {"name": name, "pairs": [], "negatives": [away]}
        path.write_text(json.dumps(content))
    write_given(root / "correspondences" / "kitti_10m_fpfh")
    return root / "pairs"


def write_given(folder: Path) -> None:
    """One pair with right correspondences, as the set of real ones is laid out."""
    folder.mkdir(parents=True)
    T, points = pose_between(1, 0), scan_room(POSES[1], seed=1)
    folders.write_ply(folder / "000_pts_src.ply", points)
    folders.write_ply(folder / "000_pts_dst.ply", scan_room(POSES[0], seed=0))
    np.save(folder / "000_src_corr.npy", points[::10].astype(np.float32))
    np.save(folder / "000_dst_corr.npy", se3.apply(T, points[::10]).astype(np.float32))
    np.savetxt(folder / "000_T_dst_src.txt", T)


def run_main(script, monkeypatch, data: Path, out: Path, *options: str | Path) -> dict:
    """Run a script as from the command line and return what it wrote."""
    words = [script.__name__, "--data", str(data), "--out", str(out), *map(str, options)]
    monkeypatch.setattr(sys, "argv", words)
    script.main()
    name = script.__name__.replace("_", "-")
    assert (out / f"{name}.png").stat().st_size > 5000
    report = json.loads((out / f"{name}.json").read_text())
    assert {"commit", "machine", "config", "date"} <= set(report["run"])
    return report


def test_recall_has_a_column_for_what_is_there(monkeypatch, data, tmp_path):
    import paper_recall

    report = run_main(paper_recall, monkeypatch, data, tmp_path, "--workers", 1)
    assert report["table_of"] == {"3DMatch FPFH: rgbd_redkitchen": "Tab. 1", "KITTI FPFH: kitti_10m_fpfh": "Tab. 3"}
    kitchen = report["recall"]["3DMatch FPFH: rgbd_redkitchen"]
    assert list(kitchen) == ["sc2", "svc_paper", "svc"]
    assert (kitchen["svc"]["num_pairs"], kitchen["svc"]["recall_percent"]) == (2, 100.0)
    assert kitchen["svc"]["accepted_and_right_percent"] == 100.0
    assert kitchen["svc_paper"]["published"]["recall_percent"] == 88.66
    given = report["recall"]["KITTI FPFH: kitti_10m_fpfh"]["sc2"]
    assert (given["num_pairs"], given["recall_percent"]) == (1, 100.0)
    assert given["translation_error_cm"] < 0.1  # the correspondences are exact: descriptors would not find this


def test_recall_of_a_whole_benchmark_has_its_own_definitions(monkeypatch, data, tmp_path):
    import paper_recall

    monkeypatch.setattr(paper_recall, "METHODS", ("sc2",))
    root = folders.write_3dlomatch(tmp_path / "lo")
    report = run_main(paper_recall, monkeypatch, data, tmp_path, "--3dlomatch", root, "--limit", 1, "--workers", 1)
    column = report["recall"]["3DLoMatch FPFH"]["sc2"]
    assert column["num_pairs"] == 1
    assert set(column["recall_by_definition"]) == {"15 deg, 0.3 m", "rmse 0.2 m, not consecutive"}
    assert column["published"]["recall_percent"] == 38.46


def test_decision_judges_two_estimates_a_pair(monkeypatch, data, tmp_path):
    import paper_decision

    report = run_main(paper_decision, monkeypatch, data, tmp_path, "--workers", 1)
    kitchen = report["decision"]["3DMatch: rgbd_redkitchen"]
    assert [kitchen[rule]["num_poses"] for rule in ("baseline", "svc_paper", "svc")] == [4, 4, 4]
    assert kitchen["baseline"]["recall"] == 1.0
    assert report["decision"]["KITTI: kitti_10m_fpfh"]["svc"]["num_poses"] == 1
    away = report["decision"]["hdl64_kitti_negatives"]
    assert (away["baseline"]["num_correct"], away["baseline"]["num_false_accepted"]) == (0, 2)
    assert report["published"]["3DMatch"]["svc_paper"][2] == 96.9
    assert {pose["strategy"] for pose in report["poses"]} == {"one_way", "mutual", "given"}


def test_hypotheses_begin_with_sc2_alone(monkeypatch, data, tmp_path):
    import paper_hypotheses

    numbers = {"svc_paper": (0, 1, 5), "svc": (1, 4)}
    monkeypatch.setattr(paper_hypotheses, "NUMBERS", numbers)
    report = run_main(paper_hypotheses, monkeypatch, data, tmp_path, "--limit", 1)
    kitchen = report["hypotheses"]["3DMatch FPFH: rgbd_redkitchen"]
    assert [point["hypotheses"] for point in kitchen["svc_paper"]] == [0, 1, 5]
    assert [point["num_pairs"] for point in kitchen["svc"]] == [1, 1]
    assert all(point["time_ms_mean"] > 0.0 for points in kitchen.values() for point in points)
    assert paper_hypotheses.changes_for("svc_paper", 0) == {"method": "sc2"}
    assert paper_hypotheses.changes_for("svc_paper", 7)["paper.max_hypotheses"] == 7


def test_time_compares_before_it_measures(monkeypatch, data, tmp_path):
    import paper_time

    report = run_main(paper_time, monkeypatch, data, tmp_path, "--points", 300, 600, "--rounds", 1)
    assert list(report["time_ms"]) == ["paper, svc_ros", "paper, cKDTree", "svc_ros", "cKDTree"]
    assert [len(values["time_ms"]) for values in report["time_ms"].values()] == [2] * 4
    assert report["published_ms"]["10000"] == 16.28
    assert len(report["curves"]) == 2  # a right pose and a wrong one


@pytest.mark.slow
def test_spread_evaluations_are_compared_with_the_serial_one(monkeypatch, data, tmp_path):
    pytest.importorskip("distributed")
    import cluster

    words = ["cluster.py", "--data", str(data), "--out", str(tmp_path), "--sets", "rgbd_redkitchen"]
    monkeypatch.setattr(sys, "argv", words)
    cluster.main()
    report = json.loads((tmp_path / "cluster.json").read_text())
    assert report["same_report"] is True
    assert report["sets"] == {"rgbd_redkitchen": {"num_pairs": 2, "num_labelled_poses": 2}}
    names = [run["run"] for run in report["runs"]]
    assert names == ["serial", "processes", "dask, local", "dask, a worker killed"]
    assert report["runs"][3]["killed_after"] in (1, 2, 3)


def test_a_spread_evaluation_that_says_something_else_is_an_error():
    import cluster

    one = {"dataset": "a", "time_ms": 1, "registration": {"pairs": [{"verdict": "accepted", "time_ms": 3}]},
           "negatives": None, "decision": None}  # fmt: skip
    slower = json.loads(json.dumps(one).replace("3", "5"))
    cluster.require_same("slower", [one], [slower])
    other = json.loads(json.dumps(one).replace("accepted", "rejected"))
    with pytest.raises(cluster.DifferentReportError, match="other: a differs from the serial run: registration"):
        cluster.require_same("other", [one], [other])
