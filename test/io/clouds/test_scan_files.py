"""Scan files as files, and the real ones against other readers."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scan_file_checks import POINTS, assert_read, assert_refused, write

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.files import SUFFIXES, read_scan


def test_missing_file(tmp_path: Path) -> None:
    assert_refused(tmp_path / "none.pcd", "no such file", error=InputError)


def test_directory(tmp_path: Path) -> None:
    folder = tmp_path / "folder.pcd"
    folder.mkdir()
    assert_refused(folder, "directory", error=InputError)


def test_unknown_suffix_lists_the_known(tmp_path: Path) -> None:
    assert_refused(write(tmp_path / "scan.obj", "v 1 2 3"), "'.obj'", *SUFFIXES, error=InputError)


def test_not_a_regular_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bin")
    assert_refused(tmp_path / "pipe.bin", "regular file", error=InputError)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_file_of_zero_bytes(tmp_path: Path, suffix: str) -> None:
    assert_refused(write(tmp_path / f"empty{suffix}", b""), "expected" if suffix not in (".npy", ".npz") else "not a")


def test_suffix_in_capitals(tmp_path: Path) -> None:
    assert_read(write(tmp_path / "scan.BIN", np.c_[POINTS, np.ones(4)].astype("<f4").tobytes()))


def test_files_as_people_have_them(shared_data: Path) -> None:
    if not (shared_data / "inputs").is_dir():
        pytest.skip(f"no inputs/ in {shared_data}")
    truth = np.load(shared_data / "inputs" / "truth.npy")
    paths = [path for path in (shared_data / "inputs").iterdir() if path.suffix in SUFFIXES]
    assert len(paths) >= 13
    for path in paths:
        np.testing.assert_allclose(read_scan(path).points, truth, atol=1e-3, err_msg=path.name)


@pytest.mark.parametrize("name", ["hdl32_easy", "hdl64_kitti_a", "os1_64_seosan", "rgbd_redkitchen"])
def test_real_files_as_open3d_reads_them(shared_data: Path, name: str) -> None:
    import open3d

    folder = shared_data / "pairs" / name / "scans"
    paths = sorted(p for p in folder.iterdir() if p.suffix in SUFFIXES)
    assert paths
    for path in paths[::3]:
        expected = np.asarray(open3d.io.read_point_cloud(str(path)).points)
        expected = expected[np.isfinite(expected).all(axis=1) & expected.any(axis=1)]
        assert_read(path, expected)


@pytest.mark.parametrize("name", ["hdl64_kitti_05_loop", "os0_64_walk"])
def test_real_bin_files(shared_data: Path, name: str) -> None:
    paths = sorted((shared_data / "pairs" / name / "scans").glob("*.bin"))
    assert paths
    for path in paths[::5]:
        expected = np.fromfile(path, "<f4").reshape(-1, 4)[:, :3]
        assert_read(path, expected[expected.any(axis=1)])


@pytest.mark.parametrize("options", [{"compressed": True}, {"write_ascii": True}, {}])
@pytest.mark.parametrize("suffix", [".pcd", ".ply"])
def test_what_open3d_writes(tmp_path: Path, suffix: str, options: dict[str, bool]) -> None:
    import open3d

    points = np.round(np.random.default_rng(0).normal(size=(20_000, 3)) * 10, 2)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    path = tmp_path / f"scan{suffix}"
    assert open3d.io.write_point_cloud(str(path), cloud, **options)
    np.testing.assert_allclose(read_scan(path).points, points, atol=1e-5)
