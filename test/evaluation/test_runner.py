"""The evaluation of a data set, on a small room whose numbers are known."""

from __future__ import annotations

import json
from pathlib import Path

import mini_data
import numpy as np
import pytest

from svc_ros.core import registration
from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import InputError
from svc_ros.core.scan import PreparedScan
from svc_ros.evaluation import evaluator
from svc_ros.evaluation.runner import evaluate_dataset, evaluate_datasets
from svc_ros.io.datasets import read_dataset

CONFIG = preset("lidar_indoor")


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    return mini_data.write_dataset(tmp_path_factory.mktemp("evaluation") / "room")


@pytest.fixture(scope="module")
def report(room) -> dict:
    return evaluate_dataset(read_dataset(room), CONFIG)


def test_the_report_has_the_keys_that_other_programs_read(report):
    assert list(report) == ["dataset", "method", "preset", "registration", "decision", "negatives", "time_ms"]
    assert set(report["registration"]) == {
        "num_pairs", "num_accepted", "num_correct_accepted", "num_false_accepted", "success_rate",
        "candidate_success_rate", "rotation_error_deg_mean", "translation_error_m_mean", "pairs",
    }  # fmt: skip
    assert set(report["registration"]["pairs"][0]) == {
        "source", "target", "overlap", "verdict", "reason", "rotation_error_deg", "translation_error_m", "time_ms",
        "probability",
    }  # fmt: skip
    assert set(report["decision"]) == {
        "num_correct", "num_wrong", "precision", "recall", "f1", "roc_auc", "recall_at_precision_99",
        "false_accepted_by_origin",
    }  # fmt: skip
    assert set(report["negatives"]) == {"num_pairs", "num_false_accepted", "pairs"}
    assert {"register_p50", "register_p95", "verify_p50", "stages_p50", "features_p50"} == set(report["time_ms"])
    json.dumps(report, allow_nan=False)


def test_pairs_are_registered_and_measured(report):
    numbers = report["registration"]
    assert (report["dataset"], report["method"], report["preset"]) == ("room", "svc", "lidar_indoor")
    assert numbers["num_pairs"] == 3
    assert numbers["num_correct_accepted"] == numbers["num_accepted"] == 2
    assert numbers["success_rate"] == numbers["candidate_success_rate"] == pytest.approx(2 / 3)
    assert 0 < numbers["rotation_error_deg_mean"] < 1
    assert 0 < numbers["translation_error_m_mean"] < 0.1


def test_a_scan_with_too_few_points_is_a_rejected_pair(report):
    row = report["registration"]["pairs"][2]
    assert (row["verdict"], row["reason"]) == ("rejected", "too_few_points")
    assert row["rotation_error_deg"] is None
    assert report["negatives"]["num_pairs"] == 1
    assert report["negatives"]["num_false_accepted"] == 0


def test_labelled_poses_are_judged_and_grey_ones_left_out(report):
    decision = report["decision"]
    assert (decision["num_correct"], decision["num_wrong"]) == (1, 1)
    assert (decision["precision"], decision["recall"], decision["roc_auc"]) == (1.0, 1.0, 1.0)
    assert decision["false_accepted_by_origin"] == {"far": 0}


def test_every_stage_has_its_time(report):
    times = report["time_ms"]
    assert 0 < times["register_p50"] <= times["register_p95"]
    assert times["verify_p50"] > 0
    assert times["stages_p50"]["features"] == times["features_p50"] > 1  # not the empty stage of a reused scan
    assert {"prepare", "matching", "hypotheses"} <= set(times["stages_p50"])


def test_several_processes_give_the_same_report(room, report):
    progress = []
    parallel = evaluate_dataset(read_dataset(room), CONFIG, None, 2, lambda *counts: progress.append(counts))
    assert mini_data.without_times(parallel) == mini_data.without_times(report)
    assert progress == [(k, 5) for k in range(1, 6)]


def test_each_scan_is_described_once(room, monkeypatch):
    described: list[int] = []
    original = registration.extract_features

    def counting(scan: PreparedScan, config):
        described.append(id(scan))
        return original(scan, config)

    monkeypatch.setattr(registration, "extract_features", counting)
    evaluate_dataset(read_dataset(room), CONFIG, limit=2)
    assert len(described) == 3  # scans 0, 1, 2; scan 1 is in both pairs


def test_the_range_of_the_data_set_replaces_the_presets(room, monkeypatch):
    seen = []
    original = registration.prepare

    def recording(scan, config):
        seen.append((config.preprocess.min_range_m, config.preprocess.max_range_m))
        return original(scan, config)

    monkeypatch.setattr(registration, "prepare", recording)
    evaluate_dataset(read_dataset(room), CONFIG, limit=1)
    assert set(seen) == {(0.3, 30.0)}


def test_limit_keeps_the_first_of_each_kind(room):
    report = evaluate_dataset(read_dataset(room), with_values(CONFIG, {"method": "sc2"}), limit=1)
    assert report["method"] == "sc2"
    assert report["registration"]["num_pairs"] == 1
    assert report["registration"]["pairs"][0]["source"] == "scans/1.bin"


@pytest.mark.parametrize("workers", [1, 2])
def test_a_scan_that_cannot_be_read_names_the_pair(room, tmp_path, workers):
    content = json.loads((room / "dataset.json").read_text())
    content["pairs"][0]["source"] = "scans/gone.bin"
    (tmp_path / "dataset.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"room: pair scans/gone\.bin -> scans/0\.bin: .*gone\.bin"):
        evaluate_dataset(read_dataset(tmp_path), CONFIG, None, workers)


@pytest.mark.parametrize(("limit", "workers"), [(0, 1), (None, 0)])
def test_senseless_counts_are_refused(room, limit, workers):
    with pytest.raises(InputError, match="at least 1"):
        evaluate_dataset(read_dataset(room), CONFIG, limit, workers)


def test_a_false_accept_is_counted_by_its_origin(room):
    report = evaluate_dataset(read_dataset(room), with_values(CONFIG, {"method": "sc2"}))  # sc2 accepts everything
    assert report["decision"]["false_accepted_by_origin"] == {"far": 1}
    assert report["decision"]["precision"] == 0.5


def test_the_thresholds_are_the_data_sets(room, tmp_path):
    content = json.loads((room / "dataset.json").read_text())
    content["success"] = {"rotation_deg": 5.0, "translation_m": 1e-9}
    content["pairs"] = content["pairs"][:1]
    for kind in ("source", "target"):
        content["pairs"][0][kind] = str(room / content["pairs"][0][kind])
    content["negatives"] = []
    (tmp_path / "dataset.json").write_text(json.dumps(content))
    report = evaluate_dataset(read_dataset(tmp_path), CONFIG)
    assert report["registration"]["num_false_accepted"] == 1
    assert report["registration"]["candidate_success_rate"] == 0.0
    assert np.isfinite(report["registration"]["pairs"][0]["translation_error_m"])
    assert report["decision"] is None
    assert report["negatives"] is None


def test_scans_of_one_set_at_a_time_are_kept_and_none_afterwards(room, monkeypatch):
    most = []
    original = evaluator.Evaluator.run

    def watching(self, job):
        most.append(len(evaluator._resident))
        return original(self, job)

    monkeypatch.setattr(evaluator.Evaluator, "run", watching)
    sets = [(read_dataset(room), with_values(CONFIG, {"method": "sc2"}))] * 3
    assert len(evaluate_datasets(sets, limit=1)) == 3
    assert set(most) == {1}
    assert evaluator._resident == {}
