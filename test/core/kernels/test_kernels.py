"""Small kernels against their slow twins, at the sizes where words of bits begin and end."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scipy.spatial.transform import Rotation

from svc_ros.core.kernels import compatibility as kernels
from svc_ros.core.se3 import make_pose

RNG = np.random.default_rng(5)


def test_popcount_counts_bits():
    borders = np.array([0, 1, 2**63, 2**64 - 1], np.uint64)
    words = np.concatenate([borders, RNG.integers(0, 2**64, 200, dtype=np.uint64)])
    assert [int(kernels.popcount(word)) for word in words] == [bin(int(word)).count("1") for word in words]


@pytest.mark.parametrize("k", [1, 3, 30, 64])
@pytest.mark.parametrize("num", [1, 2, 30, 200])
def test_largest_takes_the_smaller_index_of_equals(num, k):
    for high in (1, 2, 5, 1000):  # the lower, the more ties
        row = RNG.integers(0, high + 1, num).astype(np.int32)
        order = np.full(k, -7, np.int64)
        found = kernels.largest(row, order, k)
        np.testing.assert_array_equal(order[:found], reference.largest(row, k))
        assert (order[found:] == -7).all()


@pytest.mark.parametrize("num", [1, 3, 63, 64, 65, 200])
@pytest.mark.parametrize("radius", [0.0, 0.5, 2.0, 100.0])
def test_local_maxima_equal_the_full_distance_matrix(num, radius):
    points = np.round(RNG.normal(size=(num, 3)) * 2, 1)
    score = np.sort(RNG.integers(0, 10, num) / 10.0)[::-1].copy()  # ties: neither is larger, both stay
    found = np.zeros(num, bool)
    kernels.mark_local_maxima(0, len(points), points, score, radius, found)
    np.testing.assert_array_equal(found, reference.local_maxima(points, score, radius))


def random_poses(num: int) -> np.ndarray:
    return make_pose(Rotation.random(num, random_state=2).as_matrix(), RNG.normal(size=(num, 3)))


@pytest.mark.parametrize("num", [1, 50])
def test_scores_equal_loops_over_every_correspondence(num):
    T, x = random_poses(8), RNG.normal(size=(num, 3)) * 3
    y = x @ T[3, :3, :3].T + T[3, :3, 3] + RNG.normal(size=(num, 3)) * 0.3
    num_inliers, mae, mse = np.zeros(8, np.int64), np.zeros(8), np.zeros(8)
    kernels.score_poses(T, x, y, 0.6, num_inliers, mae, mse)
    expected = [reference.pose_scores(pose, x, y, 0.6) for pose in T]
    assert num_inliers.tolist() == [count for count, _, _ in expected]
    np.testing.assert_allclose(np.stack([mae, mse], 1), [row[1:] for row in expected], rtol=1e-9, atol=1e-12)
    assert num_inliers[3] > 0


@pytest.mark.parametrize("sizes", [[3, 5, 1], [20, 2, 20], [0, 20, 4]])
def test_weights_are_the_leading_eigenvector_of_each_set(sizes):
    x = RNG.normal(size=(60, 3)) * 5
    y = x + RNG.normal(size=(60, 3)) * 0.05
    sets = np.stack([RNG.permutation(60)[:20] for _ in sizes])
    weights = np.full((len(sizes), 20), np.nan)
    kernels.set_weights(sets, np.array(sizes), x, y, 0.3, 20, weights)
    for row, members, size in zip(weights, sets, sizes, strict=True):
        np.testing.assert_allclose(row[:size], reference.set_weights(members[:size], x, y, 0.3, 20), atol=1e-12)
        assert not row[size:].any()


def test_a_set_without_compatible_pairs_has_no_weights():
    x = RNG.normal(size=(5, 3)) * 100
    weights = np.full((1, 5), np.nan)
    kernels.set_weights(np.arange(5)[None], np.array([5]), x, x * 2, 0.1, 20, weights)
    assert not weights.any()
