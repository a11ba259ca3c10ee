"""dataset.json and candidates.json: every real set loads, every broken one is named by file and key."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.io.datasets import Dataset, read_dataset

NUM_PAIRS = {
    "os0_64_walk": (76, 0),
    "os1_64_seosan": (72, 0),
    "hdl64_kitti_a": (15, 0),
    "hdl64_kitti_05_loop": (1, 0),
    "hdl32_easy": (1, 0),
    "rgbd_redkitchen": (15, 0),
    "hdl64_kitti_negatives": (0, 12),
}
EYE = np.eye(4).tolist()


def description(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "name": "yard",
        "sensor": "VLP-16",
        "preset": "lidar_outdoor",
        "min_range_m": 1,
        "max_range_m": 80.5,
        "sensor_origin": [0, 0, 1.5],
        "success": {"rotation_deg": 5.0, "translation_m": 0.6},
        "pairs": [{"source": "a.npy", "target": "b.npy", "T_target_source": EYE, "overlap": 0.5}],
        "negatives": [{"source": "a.npy", "target": "../far/c.npy"}],
    }
    return {key: value for key, value in {**values, **changes}.items() if value is not None}


def written(folder: Path, values: object, candidates: object | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "dataset.json").write_text(json.dumps(values))
    if candidates is not None:
        (folder / "candidates.json").write_text(json.dumps(candidates))
    return folder


def test_everything_in_the_file_arrives(tmp_path: Path) -> None:
    candidate = {"T_target_source": EYE, "label": "wrong", "origin": "slip"}
    candidates = {"pairs": [{"source": "a.npy", "target": "b.npy", "candidates": [candidate]}]}
    dataset = read_dataset(written(tmp_path / "yard", description(), candidates))
    assert (dataset.name, dataset.sensor, dataset.preset) == ("yard", "VLP-16", "lidar_outdoor")
    assert (dataset.min_range_m, dataset.max_range_m) == (1.0, 80.5)
    assert (dataset.success.rotation_deg, dataset.success.translation_m) == (5.0, 0.6)
    assert (dataset.pairs[0].overlap, dataset.pairs[0].distance_m, dataset.pairs[0].reliability) == (0.5, None, "")
    assert dataset.negatives[0].T_target_source is None
    assert (dataset.candidates[0].candidates[0].label, dataset.candidates[0].candidates[0].origin) == ("wrong", "slip")


def test_what_a_small_set_may_leave_out(tmp_path: Path) -> None:
    dataset = read_dataset(written(tmp_path, description(sensor=None, sensor_origin=None, negatives=None)))
    assert (dataset.sensor, dataset.negatives, dataset.candidates) == ("", [], [])
    np.testing.assert_array_equal(dataset.sensor_origin, np.zeros(3))


def test_rounded_poses_become_exact_rotations(tmp_path: Path) -> None:
    T = np.eye(4)
    T[:2, :2] = [[0.8850754, -0.4654476], [0.4654476, 0.8850754]]  # determinant off by 1e-4
    pair = {"source": "a", "target": "b", "T_target_source": T.tolist()}
    pose = read_dataset(written(tmp_path, description(pairs=[pair]))).pairs[0].T_target_source
    assert pose is not None
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": None}, "name: missing"),
        ({"name": 3}, "name: expected a text, found 3"),
        ({"preset": "lidar_outdor"}, "did you mean 'lidar_outdoor'"),
        ({"min_range_m": "1"}, "min_range_m: expected a finite number, found '1'"),
        ({"max_range_m": True}, "max_range_m: expected a finite number, found True"),
        ({"sensor_origin": [0, 1]}, "sensor_origin: expected three numbers"),
        ({"sensor_origin": ["a", 0, 0]}, "sensor_origin: expected three numbers"),
        ({"columns": ["x", "y", "z"]}, "columns: expected a text"),
        ({"columns": "x y intensity"}, "columns: expected names in their order"),
        ({"success": {"rotation_deg": 5}}, "success.translation_m: missing"),
        ({"success": [5, 0.6]}, "success: expected an object"),
        ({"pairs": {}}, "pairs: expected a list"),
        ({"pairs": [1]}, r"pairs\[0\]: expected an object, found 1"),
        ({"pairs": [{"source": "a", "target": "b"}]}, r"pairs\[0\].T_target_source: missing"),
        (
            {"pairs": [{"source": "a", "target": "b", "T_target_source": [[1, 0], [0, 1]]}]},
            r"pairs\[0\].T_target_source: expected a 4x4 matrix, found shape \(2, 2\)",
        ),
        (
            {"pairs": [{"source": "a", "target": "b", "T_target_source": np.diag([1, 1, -1, 1]).tolist()}]},
            r"pairs\[0\].T_target_source: .*not a rotation",
        ),
        ({"negatives": [{"source": "a"}]}, r"negatives\[0\].target: missing"),
    ],
)
def test_a_broken_entry_names_file_and_key(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"dataset\.json: .*{message}"):
        read_dataset(written(tmp_path, description(**changes)))


@pytest.mark.parametrize(
    ("candidates", "message"),
    [
        ([], "the file: expected an object"),
        ({"pairs": [{"source": "a", "target": "b"}]}, r"pairs\[0\].candidates: missing"),
        (
            {"pairs": [{"source": "a", "target": "b", "candidates": [{"T_target_source": EYE, "label": "right"}]}]},
            r"pairs\[0\].candidates\[0\].label: expected one of correct, wrong, grey, found 'right'",
        ),
    ],
)
def test_broken_candidates_name_file_and_key(tmp_path: Path, candidates: object, message: str) -> None:
    with pytest.raises(InputError, match=rf"candidates\.json: {message}"):
        read_dataset(written(tmp_path, description(), candidates))


def test_folders_that_are_no_dataset(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent: expected a dataset folder, found nothing"):
        read_dataset(tmp_path / "absent")
    with pytest.raises(InputError, match=r"dataset\.json: cannot be read: No such file"):
        read_dataset(tmp_path)
    (tmp_path / "dataset.json").write_text("{broken")
    with pytest.raises(InputError, match=r"dataset\.json: expected JSON: .*line 1"):
        read_dataset(tmp_path)
    with pytest.raises(InputError, match="found a file"):
        read_dataset(tmp_path / "dataset.json")


def test_scans_are_read_with_the_sensor_origin_of_the_set(tmp_path: Path) -> None:
    dataset = read_dataset(written(tmp_path / "set", description()))
    points = np.arange(12.0).reshape(4, 3)
    np.save(tmp_path / "set" / "a.npy", points)
    np.save(tmp_path / "outside.npy", points + 1)
    np.testing.assert_allclose(dataset.read_scan("a.npy").points, points)
    np.testing.assert_array_equal(dataset.read_scan("../outside.npy").sensor_origin, [0.0, 0.0, 1.5])
    with pytest.raises(InputError, match=r"absent\.npy"):
        dataset.read_scan("absent.npy")


def test_bare_scans_are_read_by_the_columns_of_the_set(tmp_path: Path) -> None:
    dataset = read_dataset(written(tmp_path, description(columns="float64 ring x y z")))
    table = np.c_[np.full(4, 7.0), np.arange(12.0).reshape(4, 3)]
    table.tofile(tmp_path / "a.bin")
    np.testing.assert_array_equal(dataset.read_scan("a.bin").points, table[:, 1:])


@pytest.mark.parametrize("name", NUM_PAIRS)
def test_every_real_set_loads(shared_data: Path, name: str) -> None:
    dataset = read_dataset(shared_data / "pairs" / name)
    assert isinstance(dataset, Dataset)
    assert (len(dataset.pairs), len(dataset.negatives)) == NUM_PAIRS[name]
    has_candidates = (dataset.root / "candidates.json").exists()
    assert bool(dataset.candidates) == has_candidates
    for pair in dataset.pairs + dataset.negatives:
        assert (dataset.root / pair.source).is_file()
        assert (dataset.root / pair.target).is_file()
    for poses in (pair.T_target_source for pair in dataset.pairs):
        assert poses is not None
        assert np.linalg.det(poses[:3, :3]) == pytest.approx(1.0, abs=1e-12)
