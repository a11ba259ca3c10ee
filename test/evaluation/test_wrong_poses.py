"""Poses that are made to be refused: all of them wrong, spread over their range, the same in every run."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from svc_ros.core.se3 import invert, make_pose, pose_error
from svc_ros.evaluation.wrong_poses import label_of, poses_of_negative, poses_of_pair
from svc_ros.io.datasets import SuccessThresholds

SUCCESS = SuccessThresholds(5.0, 0.6)
T = make_pose(Rotation.from_euler("zyx", [70, 3, -2], degrees=True).as_matrix(), (4.0, -2.0, 0.3))
OTHERS = [make_pose(np.eye(3), (x, 0.0, 0.0)) for x in (9.0, 12.0, 15.0)]


def made(success: SuccessThresholds = SUCCESS, seed: int = 0, others=OTHERS):
    return poses_of_pair(T, others, success, np.random.default_rng(seed))


def moved(rotation_deg: float, translation_m: float) -> np.ndarray:
    turn = Rotation.from_euler("y", rotation_deg, degrees=True).as_matrix()
    return make_pose(T[:3, :3] @ turn, T[:3, 3] + (0.0, translation_m, 0.0))


@pytest.mark.parametrize(
    ("rotation_deg", "translation_m", "label"),
    [(4.9, 0.59, "correct"), (5.1, 0.0, "grey"), (0.0, 0.61, "grey"), (9.9, 1.19, "grey"), (10.1, 0.0, "wrong"),
     (0.0, 1.21, "wrong"), (180.0, 5.0, "wrong")],
)  # fmt: skip
def test_labels(rotation_deg, translation_m, label):
    assert label_of(moved(rotation_deg, translation_m), T, SUCCESS) == label


@pytest.mark.parametrize("success", [SUCCESS, SuccessThresholds(15.0, 0.3), SuccessThresholds(90.0, 0.1)])
@pytest.mark.parametrize("seed", range(5))
def test_every_label_is_true(success, seed):
    poses = made(success, seed)
    assert [pose.origin for pose in poses] == ["reference"] + ["slip"] * 4 + ["turn"] * 4 + ["far"] * 2
    for pose in poses[1:]:
        assert pose.label == "wrong"
        if pose.origin != "turn" or success.rotation_deg < 80.0:
            assert label_of(pose.T_target_source, T, success) == "wrong"
    assert np.array_equal(poses[0].T_target_source, T)
    assert poses[0].label == "correct"


def test_slips_are_horizontal_and_two_to_eight_thresholds_long():
    slips = [pose.T_target_source for pose in made() if pose.origin == "slip"]
    shifts = np.array([slip[:3, 3] - T[:3, 3] for slip in slips])
    assert np.abs(shifts[:, 2]).max() == 0.0
    assert (np.count_nonzero(shifts, axis=1) == 1).all()
    assert {tuple(np.sign(shift)) for shift in shifts} == {(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)}
    lengths = np.sort(np.linalg.norm(shifts, axis=1)) / SUCCESS.translation_m
    assert (lengths >= 2.0).all()
    assert (lengths <= 8.0).all()
    assert (np.diff(np.digitize(lengths, [3.5, 5.0, 6.5])) >= 0).all()
    assert lengths[-1] > 6.0


def test_turns_are_about_the_sources_own_axis():
    turns = [invert(T) @ pose.T_target_source for pose in made() if pose.origin == "turn"]
    for turn in turns:
        np.testing.assert_allclose(turn[:3, 3], 0.0, atol=1e-12)
        np.testing.assert_allclose(turn[2, :3], (0.0, 0.0, 1.0), atol=1e-12)
    angles = sorted(pose_error(turn, np.eye(4))[0] for turn in turns)
    assert angles[0] >= 15.0
    assert angles[-1] == pytest.approx(180.0)


def test_the_pose_of_another_pair_is_taken_only_where_it_is_wrong():
    origins = [pose.origin for pose in made(others=[T, moved(1.0, 0.1), OTHERS[0]])]
    assert origins.count("far") == 1
    assert [pose.origin for pose in made(others=[])].count("far") == 0


def test_a_seed_makes_the_same_poses_and_another_one_others():
    same, other = made(seed=3), made(seed=4)
    for a, b in zip(made(seed=3), same, strict=True):
        assert np.array_equal(a.T_target_source, b.T_target_source)
    assert not np.array_equal(same[1].T_target_source, other[1].T_target_source)


def test_negatives_have_only_wrong_poses():
    rng = np.random.default_rng(0)
    poses = poses_of_negative(None, OTHERS, SUCCESS, rng)
    assert {pose.label for pose in poses} == {"wrong"}
    assert len(poses) == 4
    assert np.array_equal(poses[0].T_target_source, np.eye(4))
    known = poses_of_negative(np.eye(4), [*OTHERS, moved(0.0, 0.0)], SUCCESS, rng)
    assert len(known) == 4  # that nothing moved is right here, and left out
    assert len(poses_of_negative(None, [], SUCCESS, rng)) == 1
