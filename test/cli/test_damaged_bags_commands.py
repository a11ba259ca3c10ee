"""What the commands say of a damaged bag, and that --strict refuses it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bag_damage import clouds, cut, ends_of_clouds
from bag_recorder import record
from command_line import assert_refused, run

MESSAGE = "drive.mcap: 2 of 3 messages of /points read; the file ends after"
NO_GTSAM = "gtsam not installed: pip install 'svc_ros[graph]'"
QUICK = ("--preset", "lidar_indoor", "--no-report")


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two of three clouds are whole."""
    path = record(tmp_path / "drive", "mcap", clouds(3))
    cut(path / "drive.mcap", ends_of_clouds(path / "drive.mcap", 3)[1])
    return path


def test_replay_warns_and_writes_the_damage_down(bag: Path, tmp_path: Path) -> None:
    result = run("replay", bag, "--out", tmp_path / "out", *QUICK)
    assert result.exit_code == 0, result.output
    (warning,) = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert MESSAGE in warning
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["num_scans"] == 2
    (damage,) = summary["damage"]
    assert (f"warning: {damage['message']}", damage["file"]) == (warning, str(bag / "drive.mcap"))
    assert damage["counts"] == {"/points": {"num_read": 2, "num_recorded": 3}}


def test_replay_of_several_bags_tells_which_are_damaged(bag: Path, tmp_path: Path) -> None:
    whole = record(tmp_path / "whole", "mcap", clouds(2))
    (whole / "metadata.yaml").unlink()  # a recorder that was killed writes none; a pattern finds the bag all the same
    result = run("replay", tmp_path / "[dw]*", "--out", tmp_path / "out", *QUICK)
    assert result.exit_code == 0, result.output
    assert result.stderr.count("warning: ") == 1
    runs = {each["out"]: each for each in json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]}
    assert [len(runs[name]["damage"]) for name in ("drive", "whole")] == [1, 0]


def test_the_report_has_the_damage_among_its_notes(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("plotly", reason="plotly is not installed")
    assert run("replay", bag, "--out", tmp_path / "out", *QUICK[:2]).exit_code == 0
    assert f"Damaged: {bag / MESSAGE}" in (tmp_path / "out" / "report.html").read_text()


def test_doctor_has_a_line_for_it(bag: Path) -> None:
    result = run("doctor", bag, "--no-trial", "--json", "-")
    findings = json.loads(result.stdout)["findings"]
    (found,) = [finding for finding in findings if finding["name"] == "damage"]
    assert found["level"] == "warn"
    assert MESSAGE in found["found"]
    assert "--strict" in found["advice"]


def test_map_warns(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason=NO_GTSAM)
    result = run("map", bag, "--out", tmp_path / "map", *QUICK[:2])
    assert f"warning: {bag / MESSAGE}" in result.stderr


@pytest.mark.parametrize("command", ["replay", "map", "calibrate", "doctor"])
def test_strict_refuses(bag: Path, tmp_path: Path, command: str) -> None:
    if command == "map":
        pytest.importorskip("gtsam", reason=NO_GTSAM)
    reference = tmp_path / "reference.txt"
    reference.write_text("1700000000 0 0 0 0 0 0 1\n1700000003 0 0 0 0 0 0 1\n")
    more = {"calibrate": ("--reference", reference, "--no-page"), "doctor": ()}.get(command, ("--out", tmp_path / "o"))
    assert_refused(run(command, bag, "--strict", *more), MESSAGE)


def test_strict_belongs_to_a_bag() -> None:
    assert run("doctor", "--strict").exit_code == 2
