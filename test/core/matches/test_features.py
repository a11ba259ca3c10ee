"""FPFH: unit rows, reproducible, and telling a wall from an edge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_surfaces
from assertions import assert_same_bits
from mini_data import POSES, scan_room

from svc_ros.core import parallel
from svc_ros.core.config import Config, preset, with_values
from svc_ros.core.matches.features import compute_features
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.core.scans.preprocess import preprocess
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


def with_neighbours(most: int) -> Config:
    return with_values(CONFIG, {"features.max_neighbours": most})


@pytest.mark.parametrize("most", [5, 40, 400])
def test_rows_are_those_of_the_definition(most):
    """A pair that stands on the border of two bins may fall into either, in float32 as in float64."""
    near = np.linalg.norm(PREPARED.points - PREPARED.points[200], axis=1) < 2.5
    part = dataclasses.replace(PREPARED, points=PREPARED.points[near], normals=PREPARED.normals[near], memo={})
    expected = reference_surfaces.fpfh(part.points, part.normals, CONFIG.feature_radius_m, most)
    found = compute_features(part, with_neighbours(most)).descriptors
    difference = np.linalg.norm(found - expected, axis=1)
    assert len(part) > 200
    assert np.median(difference) < 1e-3
    assert np.quantile(difference, 0.98) < 0.05


@pytest.mark.parametrize("most", [30, 100, 400])
def test_rows_are_those_of_open3d(most):
    o3d = pytest.importorskip("open3d")
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(PREPARED.points.copy()))
    cloud.point.normals = o3d.core.Tensor.from_numpy(PREPARED.normals.copy())
    rows = o3d.t.pipelines.registration.compute_fpfh_feature(cloud, max_nn=most, radius=CONFIG.feature_radius_m).numpy()
    expected = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    difference = np.linalg.norm(compute_features(PREPARED, with_neighbours(most)).descriptors - expected, axis=1)
    assert np.median(difference) < 1e-3
    assert np.quantile(difference, 0.98) < 0.05


def test_processors_change_nothing(monkeypatch):
    expected = compute_features(PREPARED, CONFIG).descriptors
    monkeypatch.setattr(parallel, "num_processors", lambda: 1)
    monkeypatch.setattr(parallel, "_PART", 100)
    assert_same_bits(compute_features(PREPARED, CONFIG).descriptors, expected)


def test_many_points_at_one_place_are_described():
    points = np.concatenate([np.repeat(PREPARED.points[:1], 300, 0), PREPARED.points])
    normals = np.concatenate([np.repeat(PREPARED.normals[:1], 300, 0), PREPARED.normals])
    descriptors = compute_features(PreparedScan(points, normals, np.zeros(3), 0.2), with_neighbours(50)).descriptors
    assert np.isfinite(descriptors).all()
    np.testing.assert_allclose(np.linalg.norm(descriptors, axis=1), 1, atol=1e-5)
