"""A replay of clouds that nobody can register says why, and what to do, in every mode that decides on them."""

from __future__ import annotations

from pathlib import Path

import mini_data
import numpy as np
import pytest
from replay_cases import STAMPS, WAY, job, read_decisions

from svc_ros.io.bags import CloudBagWriter
from svc_ros.replay.run import replay_bag


def bag_of(path: Path, factor: float) -> Path:
    with CloudBagWriter(path) as bag:
        for stamp_ns, T in zip(STAMPS[:3], WAY, strict=False):
            bag.write_points(stamp_ns, "lidar", factor * mini_data.scan_room(T))
    return path


@pytest.mark.parametrize("mode", ["pair", "scan_matching"])
@pytest.mark.parametrize(("factor", "hint"), [(1000.0, "millimetres?"), (np.nan, "no point can be used")])
def test_the_detail_has_the_hint(tmp_path: Path, mode: str, factor: float, hint: str) -> None:
    summary = replay_bag(job(bag_of(tmp_path / "bag", factor), tmp_path / "out", mode))
    rows = read_decisions(tmp_path / "out")
    assert {row["reason"] for row in rows} == {"too_few_points"}
    assert all(hint in row["detail"] for row in rows)
    assert hint in summary["details"]["too_few_points"]


def test_the_samples(shared_data: Path, tmp_path: Path) -> None:
    bags = shared_data / "inputs" / "bags"
    if not bags.is_dir():
        pytest.skip(f"no samples of useless bags in {bags}")
    for bag, hint in (("only_nan", "no point can be used"), ("millimetres", "millimetres?")):
        summary = replay_bag(job(bags / bag, tmp_path / bag))
        assert hint in summary["details"]["too_few_points"]
