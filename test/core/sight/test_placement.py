"""What of a scan lies under every placed point: equal to all pairs, also where there is nothing."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from scan_cases import prepared, random_scan, real_pair, thin
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import SightViewConfig
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.sight.placement import eigenvalues, place

POSE = se3.make_pose(Rotation.from_euler("zyx", [20, 3, -2], degrees=True).as_matrix(), (1.0, -0.5, 0.2))


def check_placement(observer: PreparedScan, other: PreparedScan, T: np.ndarray, config: SightViewConfig) -> int:
    """Every number of the placement by all pairs of points; returns how many points lie on something."""
    found = place(observer, other, T, config)
    points, normals = se3.apply(T, other.points), se3.rotate(T, other.normals)
    nearest = reference.nearest_within(points, observer.points, config.tolerance_m)
    np.testing.assert_array_equal(found.nearest, nearest)
    near = np.flatnonzero(nearest >= 0)
    own, planes = observer.points[nearest[near]], observer.normals[nearest[near]]
    cosine = np.einsum("ij,ij->i", normals[near], planes)
    same = cosine > config.same_side_cosine
    residual = np.abs(np.einsum("ij,ij->i", points[near] - own, planes))
    counts = (len(near), same.sum(), (cosine < -config.same_side_cosine).sum())
    assert (found.num_near, found.num_same, found.num_opposed) == counts
    assert found.num_tight == (same & (residual < 0.25 * config.tolerance_m)).sum()
    sums = planes[same].T @ planes[same]
    np.testing.assert_allclose(found.plane_sums, sums[np.triu_indices(3)], atol=1e-9)
    weakest, middle, _ = np.linalg.eigvalsh(sums)
    shares = [*(np.array([*counts, middle]) / len(other)), *(np.array([weakest, found.num_tight]) / max(counts[1], 1))]
    np.testing.assert_allclose(found.shares(), shares, atol=1e-7)
    return len(near)


@pytest.mark.parametrize("tolerance", [0.2, 0.5, 2.0])
def test_placed_random_scans_equal_all_pairs(tolerance):
    config = SightViewConfig(tolerance_m=tolerance)
    sizes = [check_placement(random_scan(900, s, 3.0), random_scan(800, s + 5, 3.0), POSE, config) for s in range(3)]
    assert min(sizes) > 0


def test_placed_real_scans_equal_all_pairs(shared_data):
    source, target, T, settings = real_pair(shared_data, "os1_64_seosan")
    source, target = (thin(preprocess(scan, settings.preprocess), 1500) for scan in (source, target))
    assert check_placement(target, source, T, SightViewConfig(tolerance_m=1.0)) > 500


@pytest.mark.parametrize("num", [0, 1, 255, 256, 257, 513])
def test_any_number_of_points_is_placed(num):
    """They are placed a few hundred at a time."""
    scan = random_scan(600, 3)
    part = prepared(scan.points[:num], scan.normals[:num])
    found = place(scan, part, np.eye(4), SightViewConfig())
    assert found.nearest.tolist() == list(range(num))
    assert found.num_same == num


def test_far_away_there_is_nothing():
    scan = random_scan(300, 1)
    found = place(scan, scan, se3.make_pose(np.eye(3), (500.0, 0, 0)), SightViewConfig())
    assert (found.nearest == -1).all()
    assert found.shares() == (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_eigenvalues_are_those_of_the_library():
    rng = np.random.default_rng(0)
    matrices = [A.T @ A for A in (rng.normal(size=(n, 3)) * scale for n in range(1, 6) for scale in (1e-4, 1.0, 300.0))]
    matrices += [np.diag(d) for d in ([0.0, 0, 0], [1.0, 1, 1], [2.0, 2, 0], [5.0, 0, 0], [3.0, 2, 1], [1.0, 1, 4])]
    turn = Rotation.random(random_state=1).as_matrix()
    matrices += [turn @ np.diag(d) @ turn.T for d in ([7.0, 7.0, 1.0], [7.0, 1.0, 1.0], [7.0, 1e-9, 0.0])]
    for matrix in matrices:
        expected = np.linalg.eigvalsh(matrix)
        found = eigenvalues(tuple(matrix[np.triu_indices(3)]))
        np.testing.assert_allclose(found, expected, atol=1e-7 * expected[-1] + 1e-300)
