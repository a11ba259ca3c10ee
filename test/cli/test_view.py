"""svc_ros view: the page of one decision on two scan files, and one line for whatever does not belong together."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_refused, run
from report_cases import data_of
from synthetic import street_pair

from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import InputError
from svc_ros.core.registration import prepare, verify
from svc_ros.io.results import result_from_json, result_to_json
from svc_ros.report.look_again import look_again

FAR = {"shortlist.max_moved_translation_m": 100.0, "shortlist.max_moved_rotation_deg": 180.0}


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """Two scans, and the decision on a wrong pose of theirs as `verify --json` writes it."""
    folder = tmp_path_factory.mktemp("view")
    source, target, T = street_pair()
    paths = {name: folder / f"{name}.npy" for name in ("source", "target")}
    np.save(paths["source"], source.points)
    np.save(paths["target"], target.points)
    np.savetxt(folder / "wrong.txt", T @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    (folder / "far.yaml").write_text("\n".join(f"{name}: {value}" for name, value in FAR.items()))
    paths |= {"result": folder / "r.json", "config": folder / "far.yaml", "out": folder / "view.html"}
    options = ("--transform", folder / "wrong.txt", "--json", paths["result"], "--config", paths["config"])
    done = run("verify", paths["source"], paths["target"], *options)
    assert done.exit_code == 0, done.output
    return paths


def view(files: dict[str, Path], *more: object, source: str = "source", target: str = "target"):
    return run("view", files[source], files[target], "--result", files["result"], *more)


def test_the_page_has_as_many_blocked_lines_and_denied_points_as_the_decision(files):
    done = view(files, "--out", files["out"])
    assert done.exit_code == 0, done.output
    assert done.stderr == f"wrote {files['out']}\n"
    data, record = data_of(files["out"]), json.loads(files["result"].read_text())
    assert (data["kind"], data["title"]) == ("view", "source.npy onto target.npy")
    (scene,) = data["scenes"]
    assert scene["target"]["num_blocked"] == record["evidence"]["num_blocked_source_in_target"] > 100
    assert scene["source"]["num_blocked"] == record["evidence"]["num_blocked_target_in_source"]
    assert scene["source"]["num_denied"] == record["evidence"]["num_denied_source_in_target"] > 100
    assert scene["target"]["num_denied"] == record["evidence"]["num_denied_target_in_source"] > 100
    assert data["told"]["0"]["verdict"] == record["verdict"] == "rejected"


def test_swapped_files_are_refused(files):
    assert_refused(view(files, source="target", target="source"), "r.json", "expected source.npy as source", "swapped")


def test_other_scans_are_refused(files, tmp_path):
    np.save(tmp_path / "source.npy", street_pair(seed=4)[0].points)
    done = run("view", tmp_path / "source.npy", files["target"], "--result", files["result"])
    assert_refused(done, "r.json", "expected a source of", "it is of other scans, or of another --preset or --config")


def test_another_preset_is_refused(files):
    assert_refused(view(files, "--preset", "lidar_indoor"), "r.json", "after preparation")


def test_another_tolerance_is_refused(files, tmp_path):
    (tmp_path / "c.yaml").write_text("preset: lidar_outdoor\nsight_view.tolerance_m: 2.0\n")
    assert_refused(view(files, "--config", tmp_path / "c.yaml"), "r.json", "blocked sight lines")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}\n{}\n", "expected one JSON object"),
        ("[1]", "found list"),
        ('{"verdict": "perhaps"}', "verdict: expected one of accepted"),
        ('{"verdict": "rejected", "reason": "low_overlap", "preset": "moon"}', "preset"),
    ],
)
def test_what_is_no_result_is_named(files, tmp_path, text, words):
    (tmp_path / "x.json").write_text(text)
    done = run("view", files["source"], files["target"], "--result", tmp_path / "x.json")
    assert_refused(done, "x.json", words)


def test_a_missing_result_is_named(files, tmp_path):
    done = run("view", files["source"], files["target"], "--result", tmp_path / "none.json")
    assert_refused(done, "none.json: cannot be read")


def test_a_scan_with_too_few_points_is_named(files, tmp_path):
    np.save(tmp_path / "few.npy", np.ones((5, 3)))
    done = run("view", tmp_path / "few.npy", files["target"], "--result", files["result"])
    assert_refused(done, "few.npy")


@pytest.mark.parametrize("method", ["svc", "svc_paper", "sc2"])
def test_every_method_is_looked_at_by_its_own_rule(method):
    source, target, T = street_pair()
    config = with_values(preset("lidar_outdoor"), {"method": method, **FAR})
    scans = prepare(source, config), prepare(target, config)
    told = verify(*scans, T @ np.diag([-1.0, -1.0, 1.0, 1.0]), config)
    seen = look_again(*scans, result_from_json(result_to_json(told)), config)
    assert told.evidence is not None
    assert seen.evidence is not None
    for name in ("source_in_target", "target_in_source"):
        ours, theirs = getattr(seen.evidence, name), getattr(told.evidence, name)
        np.testing.assert_array_equal(ours.blocked_idx, theirs.blocked_idx)
        np.testing.assert_array_equal(ours.blocker_idx, theirs.blocker_idx)
    if method == "svc":
        ours, theirs = (e.source_surface.denied_idx for e in (seen.evidence, told.evidence))
        np.testing.assert_array_equal(ours, theirs)


def test_a_result_without_a_pose_needs_no_look():
    source, target, _ = street_pair()
    config = preset("lidar_outdoor")
    scans = prepare(source, config), prepare(target, config)
    result = result_from_json({"verdict": "rejected", "reason": "no_hypothesis", "counts": {}})
    assert look_again(*scans, result, config) is result
    other = result_from_json({"verdict": "rejected", "reason": "no_hypothesis", "counts": {"target_points": 7}})
    with pytest.raises(InputError, match="expected a target of 7 points"):
        look_again(*scans, other, config)
