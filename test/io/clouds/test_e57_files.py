"""E57 files: one scan with its scanner's place, and what else such a file may hold."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_file_checks import assert_refused, write

from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.se3 import apply, make_pose
from svc_ros.io.clouds.files import read_scan

POINTS = np.random.default_rng(0).normal(size=(500, 3)) * 10
HALF_TURN, PLACE = np.array([0.0, 0.0, 0.0, 1.0]), np.array([100.0, -20.0, 3.0])  # about z


def e57(path: Path, num_scans: int = 1, **more: Any) -> Path:
    pye57 = pytest.importorskip("pye57")
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True))
    with pye57.E57(str(path), "w") as file:
        for _ in range(num_scans):
            file.write_scan_raw({**columns, **more}, rotation=HALF_TURN, translation=PLACE)
    return path


def test_e57_is_read_in_its_common_frame(tmp_path: Path) -> None:
    scan = read_scan(e57(tmp_path / "scan.E57"))
    expected = apply(make_pose(np.diag([-1.0, -1.0, 1.0]), PLACE), POINTS)
    np.testing.assert_allclose(scan.points, expected, atol=1e-5)
    np.testing.assert_array_equal(scan.sensor_origin, PLACE)


def test_e57_points_that_are_marked_invalid_are_dropped(tmp_path: Path) -> None:
    marks = (np.arange(500) % 5 == 0).astype(np.int8)
    assert len(read_scan(e57(tmp_path / "scan.e57", cartesianInvalidState=marks))) == 400


def test_e57_of_several_scans_is_refused(tmp_path: Path) -> None:
    assert_refused(e57(tmp_path / "scan.e57", num_scans=2), "expected one scan, found 2")


@pytest.mark.parametrize("share", [0.001, 0.003, 0.01, 0.5, 0.99])
def test_e57_truncated(tmp_path: Path, share: float) -> None:
    data = e57(tmp_path / "whole.e57").read_bytes()
    assert_refused(write(tmp_path / "scan.e57", data[: int(share * len(data))]), "expected")


def test_e57_with_a_broken_page(tmp_path: Path) -> None:
    data = bytearray(e57(tmp_path / "whole.e57").read_bytes())
    data[len(data) // 2] ^= 0xFF
    assert_refused(write(tmp_path / "scan.e57", bytes(data)), "not a readable E57 file")


def test_e57_without_pye57_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = struct.pack("<8sIIQ", b"ASTM-E57", 1, 0, 1024)
    path = write(tmp_path / "scan.e57", head.ljust(1024, b"\0"))
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(MissingDependencyError, match=r"scan\.e57: E57 files need pye57: pip install pye57"):
        read_scan(path)
