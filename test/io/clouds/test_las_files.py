"""LAS and LAZ files: right ones, truncated ones, and headers that claim too much."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_file_checks import POINTS, assert_refused, write

from svc_ros.core.errors import MissingDependencyError, UnsupportedCloudError
from svc_ros.io.clouds.files import read_scan


def las(path: Path, points: Any) -> Path:
    laspy = pytest.importorskip("laspy")
    if path.suffix == ".laz":
        pytest.importorskip("lazrs")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = [0.001] * 3, [100.0, 0.0, -5.0]
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.asarray(points).T
    cloud.write(str(path))
    return path


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las(tmp_path: Path, suffix: str) -> None:
    points = np.random.default_rng(0).normal(size=(500, 3)) * 20
    path = las(tmp_path / f"scan{suffix}", np.concatenate([points, np.zeros((3, 3))]))
    scan = read_scan(path)
    assert len(scan) == 500
    np.testing.assert_allclose(scan.points, points, atol=0.00051)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("share", [0.0, 0.001, 0.005, 0.02, 0.3, 0.5, 0.9, 0.999])
def test_las_truncated(tmp_path: Path, suffix: str, share: float) -> None:
    path = las(tmp_path / f"scan{suffix}", np.random.default_rng(0).normal(size=(2000, 3)))
    data = path.read_bytes()
    assert_refused(write(path, data[: int(share * len(data))]))


@pytest.mark.parametrize(("place", "cause"), [(100, "records"), (107, "truncated"), (96, "found them declared")])
def test_las_that_claims_too_much(tmp_path: Path, place: int, cause: str) -> None:
    data = bytearray(las(tmp_path / "scan.las", POINTS).read_bytes())
    data[place : place + 4] = b"\xf0\xff\xff\xff"
    assert_refused(write(tmp_path / "scan.las", bytes(data)), cause)


def test_laz_that_claims_too_many_chunks(tmp_path: Path) -> None:
    data = bytearray(las(tmp_path / "scan.laz", POINTS).read_bytes())
    (start,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, start)
    data[table + 4 : table + 8] = b"\xf0\xff\xff\xff"
    assert_refused(write(tmp_path / "scan.laz", bytes(data)), "LAZ chunks")


def test_laz_that_claims_too_large_chunks(tmp_path: Path) -> None:
    data = bytearray(las(tmp_path / "scan.laz", POINTS).read_bytes())
    place = data.index(b"laszip encoded") + 64
    assert struct.unpack_from("<I", data, place) == (50_000,)
    struct.pack_into("<I", data, place, 0x2300C350)
    assert_refused(write(tmp_path / "scan.laz", bytes(data)), "chunks of 587252560 points")


def test_laz_that_claims_too_large_points(tmp_path: Path) -> None:
    data = bytearray(las(tmp_path / "scan.laz", POINTS).read_bytes())
    place = data.index(b"laszip encoded") + 88
    assert struct.unpack_from("<H", data, place) == (20,)  # bytes of a point's first part
    struct.pack_into("<H", data, place, 60_000)
    assert_refused(write(tmp_path / "scan.laz", bytes(data)), "LAZ points of at most 4096 bytes")


@pytest.mark.parametrize(("kind", "refused"), [("PanicException", True), ("KeyboardInterrupt", False)])
def test_laz_on_whose_bytes_the_backend_panics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, refused: bool
) -> None:
    laspy = pytest.importorskip("laspy")
    path = las(tmp_path / "scan.laz", POINTS)
    panic = type(kind, (BaseException,), {})

    def end(*_: Any) -> None:
        raise panic("out of bounds")

    monkeypatch.setattr(laspy.LasReader, "read_points", end)
    with pytest.raises(UnsupportedCloudError if refused else panic, match="out of bounds"):
        read_scan(path)


def test_las_without_laspy_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = las(tmp_path / "scan.las", POINTS)
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'laspy\[lazrs\]'"):
        read_scan(path)


def test_laz_without_backend_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    laspy = pytest.importorskip("laspy")
    path = las(tmp_path / "scan.laz", POINTS)
    monkeypatch.setattr(laspy.LazBackend, "detect_available", staticmethod(lambda: ()))
    with pytest.raises(MissingDependencyError, match=r"pip install 'laspy\[lazrs\]'"):
        read_scan(path)
