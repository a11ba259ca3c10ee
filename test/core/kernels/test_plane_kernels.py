"""Sums over planes: equal to dense matrices, also of nothing; axes equal to the library's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.kernels.plane import fill_rows, find_axes, sum_squared, sum_up

POSE = se3.make_pose(Rotation.from_euler("zyx", [20, 3, -2], degrees=True).as_matrix(), (1.0, -0.5, 0.2))


@pytest.mark.parametrize("num", [0, 1, 7, 256, 1000])
def test_normal_equations_equal_dense_matrices(num):
    rng = np.random.default_rng(num)
    pairs = rng.normal(size=(9, num)) * 10
    rows, system = np.empty((7, num)), np.zeros((6, 7))
    fill_rows(POSE, pairs, rows)
    squared = sum_up(rows, system)
    source, target, normals = (part.T for part in np.split(pairs, 3))
    placed = se3.apply(POSE, source)
    residuals = np.einsum("ij,ij->i", normals, placed - target)
    J = np.hstack((normals, np.cross(placed, normals)))
    np.testing.assert_allclose(rows, np.column_stack((J, -residuals)).T, atol=1e-10)
    size = 1.0 + np.abs(J.T @ J).max(initial=0.0)
    expected = np.triu(np.column_stack((J.T @ J, -J.T @ residuals)))
    np.testing.assert_allclose(np.triu(system), expected, atol=1e-11 * size)
    assert squared == pytest.approx(float(residuals @ residuals))
    assert sum_squared(POSE, pairs) == pytest.approx(float(residuals @ residuals))
    sum_up(rows, system)  # a second time: it adds
    np.testing.assert_allclose(np.triu(system), 2 * expected, atol=1e-11 * size)


def symmetric_matrices() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    turn = Rotation.random(random_state=1).as_matrix()
    found = [A.T @ A for A in (rng.normal(size=(n, 3)) * size for n in range(1, 6) for size in (1e-5, 1.0, 1e4))]
    found += [turn @ np.diag(d) @ turn.T for d in ([7.0, 7.0, 1.0], [7.0, 1.0, 1.0], [3.0, 1e-9, 0.0], [0, 0, 1.0])]
    return [*found, np.zeros((3, 3)), np.eye(3), np.diag([3.0, 1.0, 2.0]), np.diag([1.0, -2.0, 0.0])]


@pytest.mark.parametrize("matrix", symmetric_matrices())
def test_axes_are_those_of_the_library(matrix):
    axes = np.empty((3, 3))
    values = find_axes(matrix.copy(), axes)
    size = np.abs(matrix).max() + 1e-300
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix), atol=1e-13 * size)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(axes.T @ np.diag(values) @ axes, matrix, atol=1e-13 * size)
