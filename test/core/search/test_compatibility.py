"""Sparse rows and bit sets say the same as the dense matrices that are never built."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from correspondence_cases import T_TRUE, degenerate_cases, random_case, read_kitti_case

from svc_ros.core.kernels import compatibility as kernels
from svc_ros.core.scan import Correspondences
from svc_ros.core.se3 import apply
from svc_ros.core.search.compatibility import Compatibility, compute_compatibility, leading_eigenvector

CASES = {f"random_{n}": random_case(n) for n in (1, 2, 3, 63, 64, 65, 200)} | degenerate_cases()
THRESHOLDS = (0.1, 0.6)


def dense(c: Compatibility) -> np.ndarray:
    num = len(c.starts) - 1
    A = np.eye(num, dtype=np.float32)
    for i in range(num):
        row = slice(c.starts[i], c.starts[i + 1])
        assert (np.diff(c.columns[row]) > 0).all()
        A[i, c.columns[row]] = c.values[row]
    return A


def check_against_dense(case: Correspondences, threshold: float) -> None:
    x, y, num = case.source_points, case.target_points, len(case)
    found = compute_compatibility(case, threshold)
    A, delta = reference.first_order(x, y, threshold), reference.length_differences(x, y)
    np.testing.assert_array_equal(dense(found), A)
    np.testing.assert_array_equal(reference.unpack_bits(found.loose, num), delta < threshold)
    np.testing.assert_array_equal(reference.unpack_bits(found.tight, num), delta < 0.5 * threshold)
    np.testing.assert_array_equal(leading_eigenvector(found, 20), reference.power_iteration(A, 20))
    M, row = reference.second_order(x, y, threshold), np.empty(num, np.int32)
    for seed in range(num):
        kernels.second_order_row(seed, found.loose, found.tight, row)
        np.testing.assert_array_equal(row, M[seed])


@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("name", CASES)
def test_first_and_second_order_equal_the_dense_matrices(name, threshold):
    check_against_dense(CASES[name], threshold)


@pytest.mark.parametrize(("pair", "step"), [("000", 9), ("100", 3)])
def test_on_real_correspondences(shared_data, pair, step):
    case, _ = read_kitti_case(shared_data, pair, step)
    for threshold in THRESHOLDS:
        check_against_dense(case, threshold)


def test_many_rounds_reach_the_leading_eigenvector():
    case = random_case(200)
    A = reference.first_order(case.source_points, case.target_points, 0.3).astype(np.float64)
    expected = np.abs(np.linalg.eigh(A)[1][:, -1])
    np.testing.assert_allclose(leading_eigenvector(compute_compatibility(case, 0.3), 300), expected, atol=1e-6)


def test_no_correspondences_are_no_matrix():
    found = compute_compatibility(Correspondences.from_points(np.zeros((0, 3)), np.zeros((0, 3))), 0.1)
    assert (len(found.values), len(leading_eigenvector(found, 20))) == (0, 0)


def test_right_correspondences_are_trusted_most():
    case = random_case(200)
    right = np.linalg.norm(apply(T_TRUE, case.source_points) - case.target_points, axis=1) < 0.2
    confidence = leading_eigenvector(compute_compatibility(case, 0.1), 20)
    assert right[np.argsort(-confidence)[:20]].all()
