"""What a bag is replayed with: checked, small enough to travel, and known again."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import pytest
from replay_cases import job

from svc_ros.core.errors import InputError
from svc_ros.replay.job import MODES


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("one")
    (tmp_path / "bag" / "bag.mcap").write_text("three")
    return tmp_path / "bag"


def test_a_job_travels_to_another_process(bag: Path) -> None:
    first = job(bag, Path("out"), "loop_closure", start_s=1.5)
    data = pickle.dumps(first)
    assert pickle.loads(data) == first
    assert len(data) < 10_000


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mode": "pairs"}, "did you mean 'pair'"),
        ({"max_rate_hz": 0.0}, "rate above 0 Hz, found 0"),
        ({"max_rate_hz": float("nan")}, "rate above 0 Hz"),
        ({"odometry_frame": "odom"}, "only --mode loop_closure"),
        ({"mode": "localization", "map_folder": None}, "expected --map with localization"),
        ({"map_folder": Path("map")}, "--mode pair: expected --map with localization and with no other"),
        ({"map_reference": Path("map.txt")}, "expected --map and --reference"),
        ({"reference_frame": "base_link"}, "expected --reference with it"),
    ],
)
def test_what_makes_no_sense_is_refused(bag: Path, values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        job(bag, Path("out"), **values)


def test_the_identity_is_what_decisions_depend_on(bag: Path, tmp_path: Path) -> None:
    first = job(bag, tmp_path / "out")
    same = dataclasses.replace(first, out=tmp_path / "else", max_rate_hz=3.0, with_input=True, report=True, resume=True)
    assert same.identity() == first.identity()
    assert first.identity()["bag_bytes"] == len("one") + len("three")
    assert first.identity()["map_sha256"] is None
    reference = tmp_path / "reference.txt"
    reference.write_text("1 0 0 0 0 0 0 1\n")
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "map.json").write_text("{}")
    in_map = {"mode": "localization", "map_folder": tmp_path / "map"}
    others = [in_map if mode == "localization" else {"mode": mode} for mode in MODES[1:]] + [
        {"start_s": 1.0}, {"duration_s": 1.0}, {"stride": 2}, {"sensor_frame": "lidar"}, {"reference": reference},
        {"reference": reference, "reference_frame": "base"}, {"mode": "loop_closure", "odometry_frame": "odom"},
    ]  # fmt: skip
    found = [dataclasses.replace(first, **values).identity() for values in [{}, *others]]
    assert all(found.count(identity) == 1 for identity in found)
    moved = bag.rename(tmp_path / "moved")
    assert dataclasses.replace(first, bag=moved.rename(tmp_path / "sub")).identity()["bag"] == "sub"
