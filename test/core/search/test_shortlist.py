"""Distinct poses, and refinement on correspondences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference
from assertions import assert_same_bits, assert_same_pose
from correspondence_cases import T_TRUE, random_case
from scan_cases import T_ROOM, room_config, room_scans
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig, ShortlistConfig
from svc_ros.core.matches.matching import match
from svc_ros.core.registration import extract_features
from svc_ros.core.scan import Correspondences
from svc_ros.core.search import shortlist as stage
from svc_ros.core.search.hypotheses import generate_hypotheses

LIMITS = ShortlistConfig(distinct_rotation_deg=5.0, distinct_translation_m=1.0)


def pose(yaw_deg: float = 0.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    return se3.make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), (x, y, 0.0))


def clustered_poses(num: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    angles, shifts = rng.integers(0, 5, num) * 8 + rng.normal(size=num), rng.integers(0, 4, num) * 2.0
    return np.array([pose(a, s + d) for a, s, d in zip(angles, shifts, rng.normal(size=num) * 0.3, strict=True)])


def test_near_means_near_in_rotation_and_in_translation():
    T = np.array([pose(), pose(4.9), pose(5.1), pose(0, 0.9), pose(0, 1.1), pose(4.9, 0.9), pose(180)])
    assert stage.find_near(T, pose(), LIMITS).tolist() == [True, True, False, True, False, True, False]


def test_chosen_poses_are_distinct_and_stand_for_all_others():
    T = clustered_poses(200)
    chosen = stage.select_distinct(T, LIMITS, 1000)
    errors = np.array([[se3.pose_error(a, b) for b in T] for a in T[chosen]])
    near = (errors[..., 0] <= 5.0) & (errors[..., 1] <= 1.0)
    assert 5 < len(chosen) < 100
    assert chosen[0] == 0
    assert (near[:, chosen] == np.eye(len(chosen), dtype=bool)).all()
    for k in range(200):  # each is chosen, or near to one that stands before it
        assert k in chosen or near[chosen < k, k].any()


def test_the_first_ones_are_taken_up_to_the_limit():
    T = clustered_poses(200)
    np.testing.assert_array_equal(stage.select_distinct(T, LIMITS, 4), stage.select_distinct(T, LIMITS, 1000)[:4])
    assert stage.select_distinct(np.zeros((0, 4, 4)), LIMITS, 4).shape == (0,)


def test_refinement_on_correspondences_ends_at_the_truth():
    start = T_TRUE @ pose(1.0, 0.2, -0.1)
    refined = stage.refine_on_correspondences(start, random_case(300), HypothesisConfig(), LIMITS)
    assert_same_pose(refined, T_TRUE, 0.05, 0.02)


def test_refinement_on_correspondences_leaves_a_pose_without_inliers():
    start = T_TRUE @ pose(90, 500)
    assert_same_bits(stage.refine_on_correspondences(start, random_case(300), HypothesisConfig(), LIMITS), start)
    no_rounds = dataclasses.replace(LIMITS, correspondence_rounds=0)
    assert_same_bits(stage.refine_on_correspondences(T_TRUE, random_case(300), HypothesisConfig(), no_rounds), T_TRUE)


def test_the_shortlist_is_short_distinct_and_holds_the_right_pose():
    config = room_config(shortlist__max_poses=6)
    features = [extract_features(scan, config) for scan in room_scans()]
    correspondences = match(*features, config.matching)
    hypotheses = generate_hypotheses(correspondences, config.hypotheses)
    prepared = (features[0].prepared, features[1].prepared)
    by_agreement = stage.order_by_agreement(hypotheses.T_target_source, *prepared, config)
    found = stage.shortlist(hypotheses, correspondences, by_agreement, config)
    assert 0 < len(found) <= 6
    assert len(stage.select_distinct(found, config.shortlist, 6)) == len(found)
    errors = np.array([se3.pose_error(T, T_ROOM) for T in found])
    assert ((errors[:, 0] < 5) & (errors[:, 1] < 0.3)).any()


@pytest.mark.parametrize("rounds", [0, 1, 3, 20])
def test_the_kernel_refines_as_its_twin(rounds):
    rng, config = np.random.default_rng(7), dataclasses.replace(LIMITS, correspondence_rounds=rounds)
    for seed in range(20):
        given = random_case(200, seed=seed)
        start = T_TRUE @ pose(rng.normal() * 3, rng.normal() * 0.3, rng.normal() * 0.3)
        found = stage.refine_on_correspondences(start, given, HypothesisConfig(), config)
        twin = reference.refine_on_inliers(
            start, given.source_points, given.target_points, 0.6, config.correspondence_eps_m, rounds
        )
        np.testing.assert_allclose(found, twin, atol=1e-9)


@pytest.mark.parametrize("points", ["line", "point", "two"])
def test_inliers_that_determine_no_pose_leave_it_as_it_was(points):
    t = {"line": np.linspace(0, 9, 30), "point": np.zeros(30), "two": np.array([0.0, 1.0])}[points]
    x = t[:, None] * (1.0, 0.5, 0.2)
    found = stage.refine_on_correspondences(np.eye(4), Correspondences.from_points(x, x), HypothesisConfig(), LIMITS)
    twin = reference.refine_on_inliers(np.eye(4), x, x, 0.6, LIMITS.correspondence_eps_m, 20)
    np.testing.assert_array_equal(found, np.eye(4))
    np.testing.assert_array_equal(twin, np.eye(4))
