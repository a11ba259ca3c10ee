"""Every form in which a single pose may lie in a file, and the complaints about files that hold none."""

from __future__ import annotations

import json

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import make_pose
from svc_ros.io.transform_files import read_transform

POSE = make_pose([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]], (1.5, -2.0, 0.25))


def as_text(T: np.ndarray, separator: str = " ") -> str:
    return "\n".join(separator.join(f"{v:.7f}" for v in row) for row in T) + "\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("matrix.txt", as_text(POSE)),
        ("kitti.txt", " ".join(f"{v:.7f}" for v in POSE[:3].ravel())),
        ("commas.csv", as_text(POSE, ", ")),
        ("commented.txt", "# 2 numbers in a comment: 1 2\n" + as_text(POSE)),
        ("brackets.txt", str(POSE.tolist())),
        ("nested.json", json.dumps(POSE.tolist())),
        ("flat.json", json.dumps(POSE.ravel().tolist())),
        ("result.json", json.dumps({"verdict": "accepted", "T_target_source": POSE.tolist(), "best_candidate": None})),
        ("rejected.json", json.dumps({"T_target_source": None, "best_candidate": POSE.tolist()})),
        ("result_without_suffix", json.dumps({"T_target_source": POSE.tolist()})),
    ],
)
def test_every_form_gives_the_pose(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    np.testing.assert_allclose(read_transform(tmp_path / name), POSE, atol=1e-12)


@pytest.mark.parametrize("array", [POSE, POSE[:3], POSE.ravel(), POSE.astype(np.float32)])
def test_npy_in_every_shape(tmp_path, array):
    np.save(tmp_path / "pose.npy", array)
    np.testing.assert_allclose(read_transform(tmp_path / "pose.npy"), POSE, atol=1e-6)


def test_printed_digits_become_an_exact_rotation(tmp_path):
    (tmp_path / "rounded.txt").write_text("0.8001 -0.6 0 1  0.6 0.8 0 2  0 0 1.0001 3")
    R = read_transform(tmp_path / "rounded.txt")[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "cause"),
    [
        ("short.txt", "1 0 0 0 1 0", "found 6"),
        ("empty.txt", "", "found 0"),
        ("words.txt", "left by two metres", "found text"),
        ("nan.txt", as_text(POSE).replace("1.5000000", "nan"), "NaN"),
        ("scaled.txt", as_text(2 * POSE), "last row"),
        ("mirror.txt", "1 0 0 0 0 1 0 0 0 0 -1 0", "not a rotation"),
        ("broken.json", "{", "not valid JSON"),
        ("nothing.json", '{"T_target_source": null, "best_candidate": null}', "found none"),
        ("words.json", '["a", "b"]', "matrix of numbers"),
        ("ragged.json", "[[1, 0], [0]]", "matrix of numbers"),
    ],
)
def test_what_is_no_pose_is_refused_with_file_and_cause(tmp_path, name, content, cause):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=cause) as caught:
        read_transform(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_missing_binary_and_pickled_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="not found"):
        read_transform(tmp_path / "gone.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x01" * 8)
    with pytest.raises(InputError, match="binary"):
        read_transform(tmp_path / "binary.txt")
    np.save(tmp_path / "pickle.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(InputError, match=r"pickle\.npy"):
        read_transform(tmp_path / "pickle.npy")
    (tmp_path / "cut.npy").write_bytes(b"\x93NUMPY")
    with pytest.raises(InputError, match=r"cut\.npy"):
        read_transform(tmp_path / "cut.npy")
