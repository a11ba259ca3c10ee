"""Bare numbers: their columns are told by what they say, by the name or by the user, and are refused else."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from scan_file_checks import POINTS, assert_read, assert_refused, write

from svc_ros.core.errors import ConfigError, UnsupportedCloudError
from svc_ros.io.clouds.files import read_scan


def room(num_rings: int = 32, num_steps: int = 300, turn_deg: float = 360.0) -> np.ndarray:
    """(N, 3) [m] in float32: what a spinning sensor sees of a room with a low ceiling, ring after ring of each step."""
    azimuth, elevation = np.meshgrid(
        np.radians(turn_deg * ((np.arange(num_steps) + 0.5) / num_steps - 0.5)),
        np.radians(np.linspace(-25, 15.1, num_rings)),
        indexing="ij",
    )
    along = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    walls = np.where(along > 0, [14.0, 5.0, 2.5], [-6.0, -3.0, -1.2])
    distance = np.min(walls / along, axis=-1) + np.random.default_rng(1).normal(0, 0.01, azimuth.shape)
    return (along * distance[..., None]).reshape(-1, 3).astype("<f4")


def more_columns(points: np.ndarray, kind: str) -> np.ndarray:
    """(N, 3) of intensity, ring and time, as drivers have them."""
    rng, count = np.random.default_rng(2), len(points)
    ring, times = np.arange(count) % 32, np.linspace(0, 0.1, count)
    return {
        "of a driver": np.c_[rng.integers(0, 256, count), ring, times],
        "of KITTI": np.c_[rng.gamma(2, 0.1, count).clip(0, 1).round(2), np.sort(ring), times - 0.1],
        "of zeros": np.zeros((count, 3)),
        "around its middle": np.c_[times - 0.05, ring, rng.random(count)],
        "of colours": rng.random((count, 3)),
        "stamped": np.c_[rng.integers(0, 65536, count), ring, 1.6e9 + times],
    }[kind]


ORDERS = {
    "as measured": lambda points: np.arange(len(points)),
    "shuffled": lambda points: np.random.default_rng(3).permutation(len(points)),
    "by ring": lambda points: np.argsort(np.arange(len(points)) % 32, kind="stable"),
}
KINDS = ("of a driver", "of KITTI", "of zeros", "around its middle", "of colours", "stamped")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", KINDS)
def test_columns_are_told_by_the_numbers(tmp_path: Path, kind: str, order: str) -> None:
    points = room()[ORDERS[order](room())]
    for num_columns in (3, 4, 5, 6):
        table = np.c_[points, more_columns(points, kind)][:, :num_columns]
        for dtype in ("<f4", "<f8"):
            assert_read(write(tmp_path / "scan.bin", table.astype(dtype).tobytes()), points)


def test_a_sensor_that_looks_ahead_and_drops_beams(tmp_path: Path) -> None:
    points = room(num_steps=200, turn_deg=100.0)
    dropped = np.random.default_rng(4).random(len(points))
    points[dropped < 0.3], points[dropped > 0.9] = np.nan, 0.0
    table = np.c_[points, more_columns(points, "of a driver")].astype("<f4")
    kept = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    for num_columns in (3, 4, 5, 6):
        assert_read(write(tmp_path / "scan.bin", table[:, :num_columns].tobytes()), kept)


def test_normals_are_columns_of_both_signs(tmp_path: Path) -> None:
    points = room()
    normals = -points / np.linalg.norm(points, axis=1, keepdims=True)
    assert_read(write(tmp_path / "scan.bin", np.c_[points, normals].astype("<f4").tobytes()), points)


def others() -> dict[str, bytes]:
    """Contents that are no float32 or float64 columns with x, y, z in front."""
    points = room()
    more = more_columns(points, "of a driver")
    return {
        "big-endian": np.c_[points, more[:, :1]].astype(">f4").tobytes(),
        "big-endian float64": np.c_[points, more[:, :1]].astype(">f8").tobytes(),
        "8 columns": np.c_[points, more[:, 1] > -1, more[:, :1], np.zeros((len(points), 3))].astype("<f4").tobytes(),
        "7 columns": np.c_[points, more, more[:, :1]].astype("<f4").tobytes(),
        "x, then y, then z": points.T.tobytes(),
        "intensity first": np.c_[more[:, 0], points].astype("<f4").tobytes(),
        "millimetres as integers": (points * 1000).astype("<i4").tobytes(),
        "depth image": (np.abs(points[:, 0]) * 1000).astype("<u2").tobytes(),
        "random": np.random.default_rng(0).bytes(96_000),
        "text": b"1.25 2.5 3.75\n" * 6000,
        "all alike": np.random.default_rng(0).normal(size=(9000, 4)).astype("<f4").tobytes(),
        "both signs": np.c_[points, np.random.default_rng(0).normal(size=len(points))].astype("<f4").tobytes(),
    }


@pytest.mark.parametrize("name", others())
def test_what_does_not_tell_its_columns_is_refused(tmp_path: Path, name: str) -> None:
    assert_refused(write(tmp_path / "scan.bin", others()[name]), "expected", "--columns x,y,z,intensity,ring")


@pytest.mark.parametrize("num_columns", [3, 4, 5, 6])
def test_a_cut_file_is_refused(tmp_path: Path, num_columns: int) -> None:
    points = room()
    data = np.c_[points, more_columns(points, "of a driver")][:, :num_columns].astype("<f4").tobytes()
    for cut in (1, 4, 8):
        assert_refused(write(tmp_path / "scan.bin", data[:-cut]), "truncated", f"multiple of {4 * num_columns} bytes")


def test_few_points_are_read_as_kitti_has_them_or_not_at_all(tmp_path: Path) -> None:
    table = np.c_[room()[:7], np.full((7, 3), 0.5)].astype("<f4")
    assert_read(write(tmp_path / "scan.bin", table[:, :4].tobytes()), table[:, :3])
    for num_columns in (3, 5, 6):
        assert_refused(write(tmp_path / "scan.bin", table[:, :num_columns].tobytes()), "--columns")


@pytest.mark.parametrize("columns", ["x,y,z,i,r,t,a", "i x y z t r a", "X Y Z i r t a"])
@pytest.mark.parametrize("type_name", ["float32", "float64"])
def test_columns_that_are_named_win(tmp_path: Path, columns: str, type_name: str) -> None:
    names = columns.lower().replace(",", " ").split()
    table = np.full((len(POINTS), 7), 9.0)
    table[:, [names.index(name) for name in "xyz"]] = POINTS
    for name in ("scan.bin", "scan.pcd.bin"):
        path = write(tmp_path / name, table.astype(type_name).tobytes())
        np.testing.assert_array_equal(read_scan(path, f"{type_name} {columns}").points, POINTS)


def test_named_columns_without_a_usable_point(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.bin", np.full((960, 6), np.nan, "<f4").tobytes())
    with pytest.raises(UnsupportedCloudError, match=r"none that are usable \(960 stored, 960 NaN"):
        read_scan(path, "x,y,z,intensity,ring,time")


@pytest.mark.parametrize("columns", ["x y", "x y z x", "float16 x y z", "xyz", "intensity", "float64"])
def test_names_that_are_none(tmp_path: Path, columns: str) -> None:
    with pytest.raises(ConfigError, match=r"columns: expected names .* such as x,y,z,intensity"):
        read_scan(write(tmp_path / "scan.bin", bytes(96)), columns)


def test_a_name_that_the_numbers_contradict_is_refused(tmp_path: Path) -> None:
    points = room()
    table = np.c_[points, more_columns(points, "of a driver")].astype("<f4")
    assert_read(write(tmp_path / "scan.pcd.bin", table[:, :5].tobytes()), points)
    path = write(tmp_path / "scan.pcd.bin", table[:, :4].tobytes())
    assert_refused(path, "intensity ring, as --columns or the name .pcd.bin says, found numbers of float32 x y z")
    np.testing.assert_array_equal(read_scan(path, "x,y,z,intensity").points, points)
    for columns in ("x,y,z", "x,y,z,i,r,t", "float64,x,y,z"):
        with pytest.raises(UnsupportedCloudError, match="found numbers of float32 x y z intensity;"):
            read_scan(path, columns)


def test_the_look_takes_a_hundredth_of_a_second(tmp_path: Path) -> None:
    points = room(num_rings=64, num_steps=1900)
    data = np.c_[points, more_columns(points, "of KITTI")[:, :1]].astype("<f4").tobytes()
    path = write(tmp_path / "scan.bin", data)
    np.save(tmp_path / "scan.npy", points)

    def seconds(path: Path) -> float:
        start = time.process_time()
        read_scan(path)
        return time.process_time() - start

    assert min(seconds(path) for _ in range(5)) < min(seconds(tmp_path / "scan.npy") for _ in range(5)) + 0.05
