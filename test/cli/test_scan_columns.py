"""Commands on scans of bare numbers: their columns guessed, named or refused, the answer that of the points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mini_data
import numpy as np
import pytest
from command_line import assert_refused, run

from svc_ros.io.datasets import read_dataset


def five_columns(points: np.ndarray) -> np.ndarray:
    """(N, 5) float32: x y z intensity ring."""
    rng = np.random.default_rng(len(points))
    return np.c_[points, rng.integers(0, 256, len(points)), np.arange(len(points)) % 32].astype("<f4")


def write_twice(folder: Path, name: str, points: np.ndarray, suffix: str) -> tuple[Path, Path]:
    """The same points bare with two more columns, and as .npy."""
    table = five_columns(points)
    bare, plain = folder / f"{name}{suffix}", folder / f"{name}.npy"
    table.tofile(bare)
    np.save(plain, table[:, :3])
    return bare, plain


def answer(source: Path, target: Path, *options: str) -> dict[str, Any]:
    """What `register` says but for names and times."""
    result = run("register", source, target, *options, "--json", "-")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    return {key: told[key] for key in told.keys() - {"source", "target", "time_ms"}}


@pytest.fixture(scope="module")
def rooms(tmp_path_factory) -> list[tuple[Path, Path]]:
    folder = tmp_path_factory.mktemp("rooms")
    return [write_twice(folder, f"room{k}", mini_data.scan_room(mini_data.POSES[k], k), ".pcd.bin") for k in (0, 1)]


def test_register_of_nuscenes_files_answers_as_of_the_same_points(rooms):
    (target, plain_target), (source, plain_source) = rooms
    options = ("--preset", "lidar_indoor")
    told = answer(source, target, *options)
    assert told["verdict"] == "accepted"
    assert told == answer(plain_source, plain_target, *options)


def test_columns_that_cannot_be_told_are_named(rooms, tmp_path):
    """A column of both signs could be a coordinate."""
    _, plain = rooms[0]
    points = np.load(plain)
    path = tmp_path / "scan.bin"
    np.c_[points, np.random.default_rng(0).normal(size=len(points))].astype("<f4").tofile(path)
    pose = tmp_path / "pose.txt"
    np.savetxt(pose, np.eye(4)[:3].reshape(1, 12))
    commands = [("register", path, plain), ("verify", path, plain, "--transform", pose)]
    for command in commands:
        assert_refused(run(*command), "scan.bin", "--columns x,y,z,intensity,ring")
        assert_refused(run(*command, "--columns", "x,y"), "columns: expected names", "x,y,z,intensity")
    named = run(*commands[1], "--columns", "x,y,z,velocity", "--preset", "lidar_indoor", "--json", tmp_path / "r.json")
    assert named.exit_code == 0, named.output
    assert json.loads((tmp_path / "r.json").read_text())["verdict"] == "accepted"
    view = ("view", path, plain, "--result", tmp_path / "r.json", "--out", tmp_path / "view.html")
    assert_refused(run(*view), "--columns")
    assert run(*view, "--columns", "x,y,z,velocity").exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hdl32_easy", "hdl64_kitti_a", "os1_64_highway", "vlp16_hand_held", "livox_dense"])
@pytest.mark.parametrize("suffix", [".pcd.bin", ".bin"])
def test_register_of_real_scans_in_five_columns(shared_data: Path, tmp_path: Path, name: str, suffix: str) -> None:
    dataset = read_dataset(shared_data / "pairs" / name)
    scans = [dataset.read_scan(scan).points for scan in (dataset.pairs[0].source, dataset.pairs[0].target)]
    (source, plain_source), (target, plain_target) = (
        write_twice(tmp_path, side, points, suffix) for side, points in zip(("source", "target"), scans, strict=True)
    )
    assert answer(source, target) == answer(plain_source, plain_target)
