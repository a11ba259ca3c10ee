"""The benchmarks of maps and of place search on next to nothing: what they report, and what counts as found."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.scan import Scan

S = 1_000_000_000


@pytest.fixture
def place_search(scripts):
    import place_search

    return place_search


def drive(place_search, name: str, along: list[float]) -> list:
    poses = [se3.make_pose(np.eye(3), (x, 0.0, 0.0)) for x in along]
    return [place_search.Seen(name, Scan(np.ones((1, 3)), 6 * k * S), T) for k, T in enumerate(poses)]


def test_a_place_is_found_if_an_old_scan_of_the_drive_is_near(place_search):
    sequence = drive(place_search, "a", [0, 3, 6, 3, 0.5]) + drive(place_search, "b", [0, 9, 1])
    wanted = place_search.relevant(sequence, 2.0)
    assert wanted == {3: {1}, 4: {0}, 7: {5}}
    ranked = {3: [2, 1, 0], 4: [1, 2, 0], 7: [6, 0, 5]}  # 2 and 6 are too young to count
    found = place_search.recalls(sequence, wanted, ranked, [1.0, 3.0])
    assert found == {"recall at 1": 1 / 3, "recall at 5": 1.0, "recall at 10": 1.0, "ms a scan": 2.0}


def test_a_small_map_is_measured(scripts, monkeypatch, tmp_path: Path):
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    import map_size

    for name, value in (("NUM_SCANS", 2), ("SEARCHES", 3), ("VISITS", 2)):
        monkeypatch.setattr(map_size, name, value)
    options = ("--keyframes", "30", "--sensor", "VLP-16", "--work", str(tmp_path), "--out", str(tmp_path / "out"))
    monkeypatch.setattr(sys, "argv", ["map_size.py", *options])
    map_size.main()
    found = json.loads((tmp_path / "out" / "map-size.json").read_text())
    assert found["keyframes"] == 30
    assert found["size_mb"] > 1.0
    assert 0.0 < found["before_mb"] <= found["peak_mb"]
    assert all(found[name] > 0.0 for name in ("read_s", "write_s", "optimise_s", "search_ms_p50"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]
