"""Scans in .bin, .npy and .npz files: right ones, and each way of being broken."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_file_checks import POINTS, STORED, assert_read, assert_refused, write


def kitti(points: Any) -> bytes:
    return np.c_[points, np.full(len(points), 0.5)].astype("<f4").tobytes()


def test_bin(tmp_path: Path) -> None:
    assert_read(write(tmp_path / "scan.bin", kitti(STORED)))


@pytest.mark.parametrize("extra", [1, 4, 12, 15])
def test_bin_of_other_length(tmp_path: Path, extra: int) -> None:
    path = write(tmp_path / "scan.bin", kitti(POINTS) + bytes(extra))
    assert_refused(path, "truncated", "16", f"found {64 + extra}")


def test_bin_of_nuscenes_has_the_ring_too(tmp_path: Path) -> None:
    data = np.c_[STORED, np.full((len(STORED), 2), 7.0)].astype("<f4").tobytes()
    assert_read(write(tmp_path / "LIDAR_TOP__1533151603547590.pcd.bin", data))
    assert_read(write(tmp_path / "scan.PCD.BIN", data))
    assert_refused(write(tmp_path / "cut.pcd.bin", data[:-4]), "x y z intensity ring", "multiple of 20", "found 136")
    assert_read(write(tmp_path / "0.5.bin", kitti(STORED)))


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_bin_without_a_usable_point(tmp_path: Path, value: float) -> None:
    path = write(tmp_path / "scan.bin", kitti(np.full((5, 3), value)))
    assert_refused(path, "none that are usable", "5 stored", "5 NaN" if value else "0 NaN")


def npy(array: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy(tmp_path: Path, dtype: str, order: Any) -> None:
    assert_read(write(tmp_path / "scan.npy", npy(np.asarray(STORED, dtype, order=order))))


def test_npy_with_more_columns_or_names(tmp_path: Path) -> None:
    assert_read(write(tmp_path / "a.npy", npy(np.c_[POINTS, np.ones((4, 2))])))
    table = np.zeros(4, [("i", "u1"), ("z", "f4"), ("x", "f4"), ("y", "f8")])
    for i, name in enumerate("xyz"):
        table[name] = POINTS[:, i]
    assert_read(write(tmp_path / "b.npy", npy(table)))


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((5, 2)),
        np.zeros(5),
        np.zeros((3, 500)),
        np.zeros((2, 2, 3)),
        np.float64(1.0),
        np.ones((4, 3), complex),
        np.array([["a", "b", "c"]]),
        np.zeros(4, [("x", "f4"), ("y", "f4")]),
        np.zeros(4, [("x", "f4"), ("y", "f4"), ("z", "f4", 2)]),
    ],
)
def test_npy_of_other_shape_or_type(tmp_path: Path, array: Any) -> None:
    assert_refused(write(tmp_path / "scan.npy", npy(array)), "expected", "found")


def test_npy_with_pickled_objects_is_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    data = npy(np.array([[Trap()] * 3], object), allow_pickle=True)
    assert_refused(write(tmp_path / "scan.npy", data), "pickles are never loaded")
    assert_refused(write(tmp_path / "scan.npz", npz(points=data)), "pickles are never loaded")
    assert not (tmp_path / "sprung").exists()


def test_npy_with_a_header_that_is_no_python(tmp_path: Path) -> None:
    data = npy(POINTS)
    start = data.index(b"{")
    end = data.index(b"\n")
    broken = data[:start] + b"{'descr': ('''".ljust(end - start) + data[end:]
    assert_refused(write(tmp_path / "scan.npy", broken), "not a saved NumPy array")


def test_npy_of_another_version(tmp_path: Path) -> None:
    data = npy(POINTS)
    other = write(tmp_path / "scan.npy", data[:6] + b"\3" + data[7:])
    assert_refused(other, "expected version 1 or 2 of NumPy's format, found 3.0")


def test_npy_that_claims_too_many_points(tmp_path: Path) -> None:
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)}
    np.lib.format.write_array_header_1_0(stream, header)
    data = stream.getvalue() + bytes(240)
    assert_refused(write(tmp_path / "scan.npy", data), "truncated", "(1000000000000, 3)")
    assert_refused(write(tmp_path / "scan.npz", npz(points=data)), "truncated", "(1000000000000, 3)")


def npz(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return stream.getvalue()


def test_npz_by_name_or_the_only_array(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", other=np.zeros(3), points=STORED)
    np.savez_compressed(tmp_path / "b.npz", STORED)
    assert_read(tmp_path / "a.npz")
    assert_read(tmp_path / "b.npz")


def test_npz_without_a_clear_array_lists_them(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", left=POINTS, right=POINTS)
    assert_refused(tmp_path / "a.npz", "'points'", "left, right")


@pytest.mark.parametrize("read_points", [npy, lambda points: npz(points=npy(points))])
def test_numpy_files_truncated_anywhere(tmp_path: Path, read_points: Callable[[Any], bytes]) -> None:
    data = read_points(POINTS)
    path = tmp_path / ("scan.npy" if data.startswith(b"\x93") else "scan.npz")
    for length in range(len(data)):
        assert_refused(write(path, data[:length]))
