"""FPFH: unit rows, reproducible, and telling a wall from an edge."""

from __future__ import annotations

import numpy as np
from assertions import assert_same_bits
from mini_data import POSES, scan_room

from svc_ros.core.config import preset, with_values
from svc_ros.core.features import compute_features
from svc_ros.core.preprocess import preprocess
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.core.se3 import apply, make_pose, rotate

CONFIG = with_values(preset("lidar_indoor"), {"preprocess.voxel_size_m": 0.2})
PREPARED = preprocess(Scan(scan_room(POSES[0])), CONFIG.preprocess)


def test_rows_are_unit_histograms():
    features = compute_features(PREPARED, CONFIG)
    assert features.descriptors.shape == (len(PREPARED), 33)
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, atol=1e-5)
    assert (features.descriptors >= 0).all()
    assert features.keypoints is PREPARED.points
    assert features.normals is PREPARED.normals


def test_the_same_scan_gives_the_same_bits():
    assert_same_bits(compute_features(PREPARED, CONFIG).descriptors, compute_features(PREPARED, CONFIG).descriptors)


def test_descriptors_do_not_depend_on_where_the_scan_stands():
    T = make_pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (5, -3, 2))
    moved = PreparedScan(apply(T, PREPARED.points), rotate(T, PREPARED.normals), apply(T, np.zeros((1, 3)))[0], 0.2)
    there, here = compute_features(moved, CONFIG).descriptors, compute_features(PREPARED, CONFIG).descriptors
    assert np.median((there * here).sum(1)) > 0.9999


def test_a_wall_is_not_an_edge():
    features = compute_features(PREPARED, CONFIG)
    x, y, _ = features.keypoints.T
    wall = (x < -5.9) & (np.abs(y) < 1.0)
    edge = (x < -5.5) & (y < -3.5)
    between = features.descriptors[wall] @ features.descriptors[edge].T
    within = features.descriptors[wall] @ features.descriptors[wall].T
    assert np.median(within) > np.median(between) + 0.1


def test_a_point_without_neighbours_is_described_by_zeros():
    points = np.concatenate([PREPARED.points, [[500.0, 0, 0]]])
    normals = np.concatenate([PREPARED.normals, [[-1.0, 0, 0]]])
    descriptors = compute_features(PreparedScan(points, normals, np.zeros(3), 0.2), CONFIG).descriptors
    assert not descriptors[-1].any()
    assert descriptors[:-1].any(1).all()
