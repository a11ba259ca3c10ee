"""Correspondences in .npz files: own keys, GeoTransformer's keys, and files that hold something else."""

from __future__ import annotations

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.io.correspondence_files import read_correspondences, write_correspondences

POINTS = np.arange(12.0).reshape(4, 3)


def test_what_is_written_is_read(tmp_path):
    write_correspondences(tmp_path / "scene" / "0_1.npz", POINTS, POINTS + 1.0)
    found = read_correspondences(tmp_path / "scene" / "0_1.npz")
    np.testing.assert_array_equal(found.source_points, POINTS)
    np.testing.assert_array_equal(found.target_points, POINTS + 1.0)
    np.testing.assert_array_equal(found.distance, np.zeros(4))


def test_distances_are_kept_and_scores_turned_round(tmp_path):
    order = np.array([0.1, 0.4, 0.2, 0.3])
    np.savez(tmp_path / "own.npz", source_points=POINTS, target_points=POINTS, distance=order)
    np.savez(
        tmp_path / "geotransformer.npz", src_corr_points=POINTS.astype(np.float32), ref_corr_points=POINTS + 2.0,
        corr_scores=order, ref_points=np.zeros((9, 3)), overlap=0.3,
    )  # fmt: skip
    np.testing.assert_array_equal(read_correspondences(tmp_path / "own.npz").distance, order)
    found = read_correspondences(tmp_path / "geotransformer.npz")
    np.testing.assert_array_equal(found.target_points, POINTS + 2.0)
    assert np.argmin(found.distance) == 1


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"source_points": POINTS}, "expected the keys source_points and target_points or .*, found source_points"),
        ({"source_points": POINTS, "target_points": POINTS[:3]}, "target_points: expected shape 4 x 3"),
        ({"source_points": POINTS.T, "target_points": POINTS.T}, "source_points: expected shape N x 3"),
        ({"source_points": POINTS, "target_points": POINTS * np.nan}, "target_points: expected finite numbers"),
        ({"source_points": POINTS, "target_points": POINTS, "distance": [1.0]}, "distance: expected shape 4"),
        ({"source_points": np.array([None]), "target_points": POINTS}, "expected an .npz archive of numbers"),
    ],
)
def test_other_content_is_told_with_the_file(tmp_path, arrays, message):
    np.savez(tmp_path / "pair.npz", **arrays)
    with pytest.raises(InputError, match=rf"pair\.npz: .*{message}"):
        read_correspondences(tmp_path / "pair.npz")


def test_files_that_are_none_are_told(tmp_path):
    with pytest.raises(InputError, match=r"gone\.npz: no such file"):
        read_correspondences(tmp_path / "gone.npz")
    (tmp_path / "text.npz").write_text("text")
    with pytest.raises(InputError, match=r"text\.npz: expected an .npz archive"):
        read_correspondences(tmp_path / "text.npz")
    np.save(tmp_path / "single.npy", POINTS)
    (tmp_path / "single.npy").rename(tmp_path / "single.npz")
    with pytest.raises(InputError, match=r"single\.npz: expected an .npz archive"):
        read_correspondences(tmp_path / "single.npz")
