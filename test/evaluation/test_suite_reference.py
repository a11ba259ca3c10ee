"""References refined by ICP: nearer to the truth than the positioning, kept on disk, and never silently made up."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import suite_folders as folders

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.evaluation import suite_reference
from svc_ros.evaluation.suite_reference import refine_point_to_point, refined_reference
from svc_ros.io.suites import Suite, read_suite


@pytest.fixture(scope="module")
def street(tmp_path_factory) -> Path:
    return folders.write_kitti(tmp_path_factory.mktemp("kitti"))


@pytest.fixture
def suite(street, tmp_path) -> Suite:
    return read_suite("kitti", street, tmp_path / "icp")


def test_refinement_comes_nearer_to_the_truth_and_is_kept(suite, monkeypatch):
    pair, scans = suite.pairs[0], folders.drive()
    truth = se3.invert(scans[4].T_map_lidar) @ scans[0].T_map_lidar
    before = se3.pose_error(pair.T_target_source, truth)[1]
    found = refined_reference(suite, pair)
    after = se3.pose_error(found, truth)[1]
    assert before > 0.04
    assert after < 0.6 * before
    assert suite.refined is not None
    np.testing.assert_allclose(np.load(suite.refined / "8_0_4.npy"), found, atol=1e-12)
    assert [path.name for path in suite.refined.iterdir()] == ["8_0_4.npy"]  # nothing temporary stays
    monkeypatch.setattr(suite_reference, "refine_point_to_point", None)  # would fail if it were asked again
    np.testing.assert_array_equal(refined_reference(suite, pair), found)


def test_poses_refined_by_others_are_taken_as_they_are(suite):
    assert suite.refined is not None
    suite.refined.mkdir()
    given = se3.make_pose(np.eye(3), (1.0, 2.0, 3.0))
    np.save(suite.refined / "8_0_4.npy", given)
    np.testing.assert_array_equal(refined_reference(suite, suite.pairs[0]), given)


def test_icp_finds_a_small_motion_and_leaves_a_hopeless_one():
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (4000, 3))
    T = se3.make_pose(np.eye(3), (0.03, -0.02, 0.01))
    np.testing.assert_allclose(refine_point_to_point(points, se3.apply(T, points), np.eye(4)), T, atol=1e-9)
    far = se3.make_pose(np.eye(3), (100.0, 0.0, 0.0))
    np.testing.assert_array_equal(refine_point_to_point(points, points, far), far)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_permission_is_told(suite, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(InputError, match=r"cannot be written: .*--refined names another folder"):
        refined_reference(dataclasses.replace(suite, refined=tmp_path / "locked" / "icp"), suite.pairs[0])


def test_a_file_in_place_of_the_folder_is_told(suite, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot be written: .*--refined names another folder"):
        refined_reference(dataclasses.replace(suite, refined=tmp_path / "file"), suite.pairs[0])
