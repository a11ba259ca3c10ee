"""`svc_ros calibrate` from the command line to its files: a folder, a bag with a reference, too few data, bad input."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import mini_data
import numpy as np
import pytest
import replay_cases
from command_line import assert_refused, run

from svc_ros.core.config import preset, with_values
from svc_ros.evaluation.bag_pairs import SPACINGS, BagSource, choose_pairs, dataset_of_bag
from svc_ros.evaluation.calibration.run import CalibrationOptions, calibrate
from svc_ros.evaluation.calibration.summary import Goal
from svc_ros.io.config_yaml import read_config
from svc_ros.io.datasets import read_dataset
from svc_ros.io.trajectories import read_tum, write_tum

CONFIG = preset("lidar_indoor")


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    return mini_data.write_dataset(tmp_path_factory.mktemp("calibrate") / "room")


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("calibrate_bag")
    replay_cases.write_reference(folder / "poses.tum")
    return replay_cases.write_room_bag(folder / "way")


@pytest.fixture(scope="module")
def of_folder(room, tmp_path_factory) -> tuple[Path, dict]:
    """What a promise that three pairs can keep leaves behind."""
    out = tmp_path_factory.mktemp("calibrate_out")
    result = run("calibrate", room, "--max-wrong-rate", 0.8, "--out", out, "--json", "-", "--no-page")
    assert result.exit_code == 0, result.stderr
    assert "present" in result.stderr
    return out, json.loads(result.stdout)


def reference(bag: Path) -> tuple[str, Path]:
    return "--reference", bag.parent / "poses.tum"


class TestFolder:
    def test_pairs_and_what_was_made_of_them_are_judged(self, of_folder):
        summary = of_folder[1]
        assert (summary["preset"], summary["method"], summary["num_pairs"]) == ("lidar_indoor", "svc", 2)
        assert summary["num_scans"] == 4
        assert summary["num_pairs_unusable"] == 2  # a pair and a negative with a scan of five points
        kinds = summary["num_poses_by_kind"]
        # the labelled wrong pose of candidates.json is a far one, too
        assert (kinds["register"], kinds["slip"], kinds["turn"], kinds["far"]) == (2, 8, 8, 4)
        assert kinds["reference"] == 3
        assert summary["present"]["right_accepted_share"] == 1.0
        assert summary["present"]["num_failed_pairs"] == 0
        assert summary["present"]["wrong_rate_bound"] == pytest.approx(1 - 0.05**0.5)
        assert summary["register"]["num_right"] == 2

    def test_the_yaml_is_a_configuration(self, of_folder, tmp_path):
        out, summary = of_folder
        assert {path.name for path in out.iterdir()} == {"calibration.yaml", "calibration.json"}
        assert json.loads((out / "calibration.json").read_text()) == summary
        chosen = summary["chosen"]["min_probability"]
        expected = with_values(CONFIG, {"decision.min_probability": chosen})
        assert read_config(out / "calibration.yaml", preset("lidar_outdoor")) == expected
        text = (out / "calibration.yaml").read_text()
        assert "# svc_ros calibrate on room" in text
        assert "Judged with the ranges of the data: room 0.3 to 30 m" in text
        again = run("config", "--config", out / "calibration.yaml")
        assert f"min_probability: {chosen}" in again.stdout

    def test_processes_find_the_same(self, room, of_folder):
        done = calibrate(
            [(read_dataset(room), CONFIG)], CalibrationOptions(Goal(0.8, 0.95, 0.5), workers=2, register=True)
        )
        assert done == {key: value for key, value in of_folder[1].items() if key in done}

    def test_a_demand_of_the_configuration_hides_nothing(self, room, tmp_path):
        (tmp_path / "strict.yaml").write_text("decision.min_probability: 0.9999\n")
        words = ("--no-register", "--config", tmp_path / "strict.yaml", "--json", "-", "--max-wrong-rate", 0.8)
        summary = json.loads(run("calibrate", room, *words).stdout)
        assert summary["present"]["min_probability"] == 0.9999
        assert summary["present"]["right_accepted_share"] < 1.0
        assert summary["chosen"]["min_probability"] == 0.5
        assert summary["chosen"]["right_accepted_share"] == 1.0
        assert summary["register"] is None

    def test_too_few_data_say_what_is_missing_and_write_no_value(self, room, tmp_path):
        (tmp_path / "calibration.yaml").write_text("decision.min_probability: 0.7\n")  # of an earlier run
        words = ("calibrate", room, "--no-register", "--no-page", "--out", tmp_path)
        result = run(*words)
        assert result.exit_code == 0
        assert "Too few pairs: 1 % takes 299 pairs" in result.stdout.replace("\n", " ")
        assert "these are 2, 297 too few" in result.stdout.replace("\n", " ")
        assert "--best-effort" in result.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["calibration.json"]
        assert run(*words, "--best-effort").exit_code == 0
        assert "# Too few pairs" in (tmp_path / "calibration.yaml").read_text()

    def test_wrong_references_are_found(self, room, tmp_path):
        """With a reference that is 3 m off, what is accepted is wrong, and told as the first thing to look at."""
        dataset = json.loads((room / "dataset.json").read_text())
        del dataset["pairs"][2], dataset["negatives"]
        dataset["pairs"][0]["T_target_source"][0][3] += 3.0
        for pair in dataset["pairs"]:
            pair.update({side: str(room / pair[side]) for side in ("source", "target")})
        (tmp_path / "dataset.json").write_text(json.dumps(dataset))
        result = run("calibrate", tmp_path, "--json", "-", "--max-wrong-rate", 0.99)
        summary = json.loads(result.stdout)
        assert summary["present"]["num_failed_pairs"] == 1
        (worst,) = [row for row in summary["wrong_accepted"] if row["kind"] == "register"]
        assert worst["translation_error_m"] == pytest.approx(3.0, abs=0.2)
        assert worst["pair"].endswith("1.bin")
        assert summary["chosen"] is not None

    def test_sets_of_one_name_are_kept_apart(self, room):
        sets = [(read_dataset(room), CONFIG)] * 2
        summary = calibrate(sets, CalibrationOptions(Goal(0.8, 0.95, 0.5), register=False, limit=1))
        assert summary["num_pairs"] == 2
        assert [one["dataset"] for one in summary["datasets"]] == ["room (1)", "room (2)"]


class TestBag:
    def test_a_bag_with_a_reference_leaves_all_files(self, bag, tmp_path):
        pytest.importorskip("plotly")
        words = ("--preset", "lidar_indoor", "--limit", 3, "--max-wrong-rate", 0.7, "--out", tmp_path / "out")
        result = run("calibrate", bag, *reference(bag), *words)
        assert result.exit_code == 0, result.stderr
        assert "With decision.min_probability" in result.stdout
        names = {path.name for path in (tmp_path / "out").iterdir()}
        assert names == {"calibration.yaml", "calibration.json", "calibration.html"}
        summary = json.loads((tmp_path / "out" / "calibration.json").read_text())
        assert summary["num_pairs"] == 3
        assert summary["present"]["num_failed_pairs"] == 0
        assert summary["present"]["right_accepted_share"] == 1.0

    def test_its_scans_and_poses_are_those_of_the_bag(self, bag, tmp_path):
        source = BagSource(bag, bag.parent / "poses.tum")
        dataset = dataset_of_bag(source, "lidar_indoor", CONFIG, (4, 2), tmp_path)
        assert (len(dataset.pairs), len(dataset.negatives)) == (4, 0)
        for pair in dataset.pairs:
            s, t = int(pair.source), int(pair.target)
            T = np.linalg.inv(replay_cases.WAY[t]) @ replay_cases.WAY[s]
            np.testing.assert_allclose(pair.T_target_source, T, atol=1e-9)
        scan = dataset.read_scan(dataset.pairs[0].source)
        points = mini_data.scan_room(replay_cases.WAY[int(dataset.pairs[0].source)], seed=int(dataset.pairs[0].source))
        np.testing.assert_allclose(scan.points, points, atol=1e-5)

    def test_poses_of_another_frame_are_carried_over(self, bag, tmp_path):
        way = read_tum(bag.parent / "poses.tum")
        mounting = np.linalg.inv(replay_cases.MOUNTING)
        write_tum(tmp_path / "base.tum", type(way)(way.stamps_ns, way.poses @ mounting))
        source = BagSource(bag, tmp_path / "base.tum", reference_frame="base_link", sensor_frame="base_link")
        dataset = dataset_of_bag(source, "lidar_indoor", CONFIG, (4, 2), tmp_path)
        pair = dataset.pairs[0]
        T = np.linalg.inv(replay_cases.WAY[int(pair.target)]) @ replay_cases.WAY[int(pair.source)]
        np.testing.assert_allclose(pair.T_target_source, T, atol=1e-6)
        np.testing.assert_allclose(dataset.read_scan(pair.source).sensor_origin, mounting[:3, 3], atol=1e-9)

    def test_pairs_are_near_and_farther_and_of_other_passes(self):
        way = [mini_data.sensor_pose(x, 0.0, 0.0) for x in (*np.arange(0, 60, 0.5), *np.arange(60, 0, -0.5))]
        stamps, poses = np.arange(len(way)) * 500_000_000, np.stack(way)
        spacing = SPACINGS["lidar_indoor"]
        pairs, negatives = choose_pairs(stamps, poses, spacing, (60, 30))
        assert (len(pairs), len(negatives)) == (60, 30)
        assert len({frozenset(pair) for pair in (*pairs, *negatives)}) == 90
        distance = np.array([np.linalg.norm(poses[s, :3, 3] - poses[t, :3, 3]) for s, t in pairs])
        gap = np.array([abs(stamps[s] - stamps[t]) for s, t in pairs]) * 1e-9
        assert distance.max() <= spacing.far_m
        assert (distance < 1.4).sum() > 10
        assert (distance > 1.4).sum() > 10
        assert (gap > spacing.revisit_s).sum() > 10
        assert min(np.linalg.norm(poses[s, :3, 3] - poses[t, :3, 3]) for s, t in negatives) >= spacing.apart_m
        assert max(s for s, _ in pairs) - min(s for s, _ in pairs) > 200
        assert choose_pairs(stamps, poses, spacing, (60, 30)) == (pairs, negatives)
        assert len(choose_pairs(stamps, poses, spacing, (10_000, 0))[0]) <= 3 * len(way)
        assert choose_pairs(stamps[:1], poses[:1], spacing, (5, 5)) == ([], [])


class TestBadInput:
    def test_what_is_no_data(self, room, bag, tmp_path):
        assert_refused(run("calibrate", tmp_path / "gone"), "gone", "expected a folder with dataset.json", "nothing")
        assert_refused(run("calibrate", tmp_path), str(tmp_path), "dataset.json", "--reference")
        assert_refused(run("calibrate", bag), str(bag), "--reference TUM")
        assert_refused(run("calibrate", room, *reference(bag)), "--reference", "(0)", "found 1")
        assert_refused(run("calibrate", room, room), "room", "twice")
        assert_refused(run("calibrate", tmp_path, *reference(bag)), "metadata.yaml")

    def test_references_that_do_not_fit(self, bag, tmp_path):
        (tmp_path / "late.tum").write_text("1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n")
        assert_refused(run("calibrate", bag, "--reference", tmp_path / "late.tum"), "late.tum", "found 0 of 7")
        words = ("calibrate", bag, *reference(bag), "--preset", "lidar_outdoor")
        assert_refused(run(*words), "1.2 to 15 m apart", "none among 7", "lidar_outdoor")
        assert_refused(run(*words, "--reference-frame", "mast"), "mast", "base_link")

    @pytest.mark.parametrize(
        ("words", "found"),
        [
            (("--max-wrong-rate", 0), ["rate", "between 0 and 1", "0"]),
            (("--confidence", 95), ["confidence", "between 0 and 1", "95"]),
            (("--method", "sc2"), ["method svc", "found sc2"]),
            (("--limit", 0), ["--limit"]),
            (("--json", "/gone/x.json"), ["--json", "does not exist"]),
        ],
    )
    def test_options(self, room, words, found):
        assert_refused(run("calibrate", room, *words), *found)

    def test_presets_that_differ(self, room, tmp_path):
        other = json.loads((room / "dataset.json").read_text()) | {"preset": "lidar_outdoor", "name": "street"}
        (tmp_path / "dataset.json").write_text(json.dumps(other))
        result = run("calibrate", room, tmp_path)
        assert_refused(result, "one preset", "lidar_indoor (room)", "lidar_outdoor (street)", "--preset")

    def test_scans_that_cannot_be_judged(self, room, tmp_path):
        few, scan = str(room / "scans/few.bin"), str(room / "scans/0.bin")
        other = json.loads((room / "dataset.json").read_text())
        other |= {"pairs": [], "negatives": [{"source": few, "target": scan}]}
        (tmp_path / "dataset.json").write_text(json.dumps(other))
        assert_refused(run("calibrate", tmp_path), "room", "expected pairs", "none among 1", "points")
        other["pairs"] = [{"source": "gone.bin", "target": scan, "T_target_source": np.eye(4).tolist()}]
        (tmp_path / "dataset.json").write_text(json.dumps(other))
        assert_refused(run("calibrate", tmp_path), "room: pair gone.bin", "gone.bin")

    def test_without_plotly_it_is_told_before_the_work(self, room, tmp_path, monkeypatch):
        monkeypatch.setattr(importlib.util, "find_spec", lambda name, *_: None)
        result = run("calibrate", room, "--out", tmp_path / "out")
        assert_refused(result, "plotly", "--no-page")
        assert not (tmp_path / "out").exists()
