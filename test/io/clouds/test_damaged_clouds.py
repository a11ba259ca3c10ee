"""Damaged scan files of every format are read or refused by name: no crash, no hang, no memory without end."""

from __future__ import annotations

import contextlib
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from damaged_files import read_damaged
from scan_file_checks import write
from test_pcd_files import pcd, xyz

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.files import read_scan

POINTS = np.round(np.random.default_rng(0).normal(size=(300, 3)) * [20, 10, 2], 3)
FACES = ["element face 1", "property list uchar int vertex_indices"]
TIMES_THE_FILE, TIMES_A_TEXT = 16, 64  # docs/formats.md
UNPACKED = {".npz": 1032, ".laz": 1032, "compressed.pcd": 88}  # times the file, that damage can make of it
ONCE = 48 << 20  # bytes that a library may take besides


def text(separator: str) -> bytes:
    return "".join(separator.join(f"{value:g}" for value in point) + "\n" for point in POINTS).encode()


def ply(encoding: str, body: bytes) -> bytes:
    vertices = [f"element vertex {len(POINTS)}", *(f"property float {name}" for name in "xyz")]
    return "\n".join(["ply", f"format {encoding} 1.0", *FACES, *vertices, "end_header\n"]).encode() + body


def sample(name: str, folder: Path) -> Path:
    """A sound file of a format; `name` ends in its suffix."""
    path, numbers = folder / name, POINTS.astype("<f4")
    face = b"\x03" + np.arange(3, dtype="<i4").tobytes()
    contents = {
        "bare.bin": np.c_[numbers, np.ones((len(POINTS), 1), "<f4")].tobytes(),
        "nuscenes.pcd.bin": np.c_[numbers, np.ones((len(POINTS), 2), "<f4")].tobytes(),
        "plain.xyz": text(" "),
        "named.csv": b"x,y,z\n" + text(","),
        "counted.pts": b"%d\n" % len(POINTS) + text(" "),
        "ascii.pcd": pcd(xyz(POINTS), "ascii"),
        "binary.pcd": pcd(xyz(POINTS), "binary"),
        "compressed.pcd": pcd(xyz(POINTS), "binary_compressed"),
        "ascii.ply": ply("ascii", b"3 0 1 2\n" + text(" ")),
        "binary.ply": ply("binary_little_endian", face + numbers.tobytes()),
    }
    if name in contents:
        return write(path, contents[name])
    if path.suffix == ".npy":
        np.save(path, POINTS)
    elif path.suffix == ".npz":
        np.savez_compressed(path, points=POINTS)
    elif path.suffix == ".e57":
        write_e57(path)
    else:
        write_las(path)
    return path


def write_las(path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.4"))
    cloud.header.scales = [0.001] * 3
    cloud.x, cloud.y, cloud.z = POINTS.T
    cloud.write(str(path))


def write_e57(path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    with pye57.E57(str(path), "w") as file:
        file.write_scan_raw(dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True)))


NAMES = [
    "bare.bin", "nuscenes.pcd.bin", "plain.xyz", "named.csv", "counted.pts", "ascii.pcd", "binary.pcd",
    "compressed.pcd", "ascii.ply", "binary.ply", "array.npy", "array.npz", "plain.las", "packed.laz", "one.e57",
]  # fmt: skip


def most_bytes(path: Path) -> int:
    is_text = path.suffix in (".xyz", ".csv", ".pts") or path.name.startswith("ascii")
    times = (TIMES_A_TEXT if is_text else TIMES_THE_FILE) * UNPACKED.get(path.suffix, UNPACKED.get(path.name, 1))
    return ONCE + times * 2 * path.stat().st_size  # damage may double a file


SHORT_LINES = {
    "short.txt": b"1 2 3\n" * 20_000,
    "shorter.txt": b"1 2 3\n" + b"12\n" * 40_000,
    "blank.txt": b"\n" * 120_000,
    "short.pcd": pcd(xyz(np.empty((0, 3))), "ascii", WIDTH="20000", POINTS="20000") + b"1 2 3\n" * 20_000,
    "lists.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 20000\nproperty char x\nproperty char y\n"
    b"property char z\nproperty list uchar char seen\nend_header\n" + b"\1\2\3\0" * 20_000,
}


@pytest.mark.parametrize("name", SHORT_LINES)
def test_lines_of_few_bytes_take_no_more_memory_than_told(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / name, SHORT_LINES[name])
    tracemalloc.start()
    try:
        with contextlib.suppress(UnsupportedCloudError):
            read_scan(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < TIMES_A_TEXT * path.stat().st_size + 1e6


@pytest.mark.parametrize("name", NAMES)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    path = sample(name, tmp_path)
    counts = read_damaged(read_scan, path, tmp_path, range(200), most_bytes(path))
    assert counts["refused"]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_ten_thousand_damaged_files(tmp_path: Path, name: str) -> None:
    path = sample(name, tmp_path)
    counts = read_damaged(read_scan, path, tmp_path, range(1000, 11_000), most_bytes(path))
    assert counts["refused"]
