"""Rigid motions: exact near the angles where formulas break, and honest about sets that determine no rotation."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import assert_same_pose
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.errors import InputError

RNG = np.random.default_rng(20)


def random_poses(num: int) -> np.ndarray:
    return se3.make_pose(Rotation.random(num, random_state=7).as_matrix(), RNG.normal(size=(num, 3)) * 20)


def test_invert_undoes_apply_in_batches():
    points = RNG.normal(size=(40, 3)) * 30
    for T, T_inverse in zip(random_poses(20), se3.invert(random_poses(20)), strict=True):
        np.testing.assert_allclose(se3.invert(se3.invert(T)), T, atol=1e-12)
        assert T_inverse.shape == (4, 4)
        np.testing.assert_allclose(se3.apply(se3.invert(T), se3.apply(T, points)), points, atol=1e-10)


def test_apply_is_rotation_plus_translation():
    T = se3.make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1, 2, 3))
    np.testing.assert_allclose(se3.apply(T, [[1, 0, 0]]), [[1, 3, 3]], atol=1e-12)
    np.testing.assert_allclose(se3.rotate(T, [[1, 0, 0]]), [[0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-3, 30.0, 90.0, 179.0, 180 - 1e-6, 180.0])
def test_angle_is_exact_near_zero_and_half_a_turn(angle):
    axes = RNG.normal(size=(10, 3))
    R = Rotation.from_rotvec(np.radians(angle) * axes / np.linalg.norm(axes, axis=1)[:, None]).as_matrix()
    np.testing.assert_allclose(se3.rotation_angle_deg(R), angle, rtol=1e-6, atol=1e-11 if angle < 1 else 1e-9)


def test_pose_error_names_degrees_and_metres():
    T = se3.make_pose(Rotation.from_euler("y", 7, degrees=True).as_matrix(), (3, 4, 0))
    np.testing.assert_allclose(se3.pose_error(T, np.eye(4)), (7, 5))


@pytest.mark.parametrize(
    ("T", "words"),
    [
        (np.eye(3), "shape"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1, 1, -1, 1]), "not a rotation"),
        (2 * np.eye(4), "last row"),
        (np.diag([2, 2, 2, 1]), "not a rotation"),
        ("pose", "numbers"),
        ([[1, 2], [3]], "numbers"),
    ],
)
def test_what_is_no_pose_is_refused_in_words(T, words):
    with pytest.raises(InputError, match=words):
        se3.check_pose(T, "T_given")


def test_a_pose_read_from_rounded_text_becomes_a_rotation_again():
    T = random_poses(1)[0]
    repaired = se3.nearest_pose(se3.check_pose(np.round(T, 4)))
    assert_same_pose(repaired, T, 0.02, 2e-4)
    np.testing.assert_allclose(repaired[:3, :3] @ repaired[:3, :3].T, np.eye(3), atol=1e-14)


def weighted_sets(num: int, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x = RNG.normal(size=(num, size, 3)) * RNG.uniform(0.1, 30, size=(num, 1, 1)) + RNG.normal(size=(num, 1, 3)) * 20
    T = random_poses(num)
    y = np.stack([se3.apply(pose, points) for pose, points in zip(T, x, strict=True)])
    return x, y + RNG.normal(size=y.shape) * 0.05, RNG.random((num, size))


@pytest.mark.parametrize("size", [3, 4, 20])
def test_kabsch_equals_scipy(size):
    x, y, w = weighted_sets(60, size)
    poses, valid = se3.kabsch(x, y, w)
    assert valid.all()
    for k in range(len(x)):
        mean_x, mean_y = np.average(x[k], axis=0, weights=w[k]), np.average(y[k], axis=0, weights=w[k])
        R = Rotation.align_vectors(y[k] - mean_y, x[k] - mean_x, weights=w[k])[0].as_matrix()
        np.testing.assert_allclose(poses[k, :3, :3], R, atol=1e-9)
        np.testing.assert_allclose(poses[k, :3, 3], mean_y - R @ mean_x, atol=1e-7)


def test_kabsch_gives_a_rotation_where_the_best_fit_is_a_reflection():
    x, _, w = weighted_sets(30, 20)
    y = x * (1, 1, -1)
    poses, valid = se3.kabsch(x, y, w)
    assert valid.all()
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1, atol=1e-9)
    for k in range(len(x)):
        centred = (a - np.average(a, axis=0, weights=w[k]) for a in (y[k], x[k]))
        R = Rotation.align_vectors(*centred, weights=w[k])[0].as_matrix()
        np.testing.assert_allclose(poses[k, :3, :3], R, atol=1e-6)


def test_kabsch_solves_a_plane():
    x, _, w = weighted_sets(30, 10)
    x[..., 2] = 4.2
    T = random_poses(30)
    y = np.stack([se3.apply(pose, points) for pose, points in zip(T, x, strict=True)])
    poses, valid = se3.kabsch(x, y, w)
    assert valid.all()
    np.testing.assert_allclose(poses, T, atol=1e-6)


def test_kabsch_knows_that_a_line_or_a_point_determines_nothing():
    start, direction = RNG.normal(size=(50, 1, 3)) * 100, RNG.normal(size=(50, 1, 3))
    line = start + RNG.normal(size=(50, 20, 1)) * direction
    point = np.repeat(start, 20, axis=1)
    pair = np.concatenate([np.repeat(start, 10, 1), np.repeat(start + direction, 10, 1)], 1)
    for x in (line, point, pair):
        poses, valid = se3.kabsch(x, x + np.array([1.0, 2, 3]), RNG.random((50, 20)))
        assert not valid.any()
        assert np.isnan(poses).all()


def test_kabsch_ignores_points_of_no_weight():
    x, y, w = weighted_sets(5, 20)
    y[:, 10:] += 100
    w[:, 10:] = 0
    np.testing.assert_allclose(se3.kabsch(x, y, w)[0], se3.kabsch(x[:, :10], y[:, :10], w[:, :10])[0], atol=1e-9)
    assert not se3.kabsch(x, y, np.zeros_like(w))[1].any()
    two_left = np.zeros_like(w)
    two_left[:, :2] = 1
    assert not se3.kabsch(x, y, two_left)[1].any()


def test_kabsch_of_no_sets_is_no_pose():
    poses, valid = se3.kabsch(np.zeros((0, 20, 3)), np.zeros((0, 20, 3)), np.zeros((0, 20)))
    assert (poses.shape, valid.shape) == ((0, 4, 4), (0,))


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 1e-3, 0.05, 0.3])
def test_the_nearest_pose_is_that_of_the_singular_values(size):
    rng = np.random.default_rng(4)
    for R in Rotation.random(20, random_state=2).as_matrix():
        rough = se3.make_pose(R + size * rng.uniform(-1, 1, (3, 3)), (1.0, -2.0, 3.0))
        U, _, Vt = np.linalg.svd(rough[:3, :3])
        found = se3.nearest_pose(rough)
        np.testing.assert_allclose(found[:3, :3], U @ Vt, atol=3e-15)
        np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=2e-15)
        np.testing.assert_array_equal(found[:3, 3], rough[:3, 3])


def test_a_mirrored_matrix_becomes_a_rotation():
    found = se3.nearest_pose(np.diag([1.0, 1.0, -1.0, 1.0]))
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 30.0, 90.0, 150.0, 179.0])
def test_one_direction_is_turned_onto_another_by_the_smallest_angle(angle):
    for start, other in Rotation.random(20, random_state=3).as_matrix()[:, :2]:
        axis = np.cross(start, other)
        end = Rotation.from_rotvec(np.radians(angle) * axis).apply(start)
        R = se3.turn_onto(start, end)
        np.testing.assert_allclose(R @ start, end, atol=1e-9)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(R @ axis, axis, atol=1e-9)  # about the one axis that leaves nothing to choose
        np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)
        np.testing.assert_allclose(se3.rotation_angle_deg(R), angle, atol=1e-7)
        np.testing.assert_allclose(se3.turn_onto(end, start), R.T, atol=1e-9)


def test_a_direction_that_is_there_already_is_not_turned():
    np.testing.assert_array_equal(se3.turn_onto((0, 0, 1), (0, 0, 1)), np.eye(3))
