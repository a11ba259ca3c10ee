"""Seeds, consensus sets and poses equal a dense slow twin, and the right pose is found where there is one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference
from assertions import assert_same_bits, assert_same_pose
from correspondence_cases import T_TRUE, degenerate_cases, random_case, read_kitti_case
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig
from svc_ros.core.scan import Correspondences
from svc_ros.core.search import hypotheses as stage
from svc_ros.core.search.compatibility import compute_compatibility, leading_eigenvector

CASES = {f"random_{n}": random_case(n) for n in (3, 63, 64, 65, 200)} | degenerate_cases()
CONFIG = HypothesisConfig()
SMALL_SETS = HypothesisConfig(first_consensus=10, second_consensus=4, compatibility_threshold_m=0.3)


def find_both(case: Correspondences, config: HypothesisConfig):
    """Seeds and consensus sets, fast and slow."""
    x, y, threshold = case.source_points, case.target_points, config.compatibility_threshold_m
    compatibility = compute_compatibility(case, threshold)
    confidence = leading_eigenvector(compatibility, config.power_iterations)
    seeds = stage.select_seeds(x, confidence, config)
    sets, sizes = stage.find_consensus_sets(case, seeds, compatibility.loose, compatibility.tight, config)
    slow_confidence = reference.power_iteration(reference.first_order(x, y, threshold), config.power_iterations)
    slow_seeds = reference.seeds(x, slow_confidence, config.nms_radius_m, max(1, int(config.seed_ratio * len(case))))
    delta, M = reference.length_differences(x, y), reference.second_order(x, y, threshold)
    k1, k2 = config.first_consensus, config.second_consensus
    slow_sets = [reference.consensus_set(seed, delta, M, threshold, k1, k2) for seed in slow_seeds]
    return seeds, [row[:size] for row, size in zip(sets, sizes, strict=True)], slow_seeds, slow_sets


def check_against_dense(case: Correspondences, config: HypothesisConfig) -> None:
    seeds, sets, slow_seeds, slow_sets = find_both(case, config)
    np.testing.assert_array_equal(seeds, slow_seeds)
    assert [row.tolist() for row in sets] == [row.tolist() for row in slow_sets]


@pytest.mark.parametrize("config", [CONFIG, SMALL_SETS], ids=["default", "small_sets"])
@pytest.mark.parametrize("name", CASES)
def test_seeds_and_consensus_sets_equal_the_dense_twin(name, config):
    check_against_dense(CASES[name], config)


@pytest.mark.parametrize(("pair", "step"), [("000", 9), ("050", 3), ("100", 3)])
def test_on_real_correspondences(shared_data, pair, step):
    check_against_dense(read_kitti_case(shared_data, pair, step)[0], CONFIG)


@pytest.mark.parametrize("ranking", ["ic", "mae", "mse"])
def test_poses_and_ranks_equal_the_dense_twin(ranking):
    case = random_case(200)
    config = dataclasses.replace(CONFIG, ranking=ranking)
    x, y, threshold = case.source_points, case.target_points, config.compatibility_threshold_m
    expected = []
    for members in find_both(case, config)[3]:
        weights = reference.set_weights(members, x, y, threshold, config.power_iterations)
        T, valid = se3.kabsch(x[members][None], y[members][None], weights[None])
        if valid[0] and len(members) >= 3:
            expected.append((T[0], *reference.pose_scores(T[0], x, y, config.inlier_threshold_m)))
    scores = np.array([row[1 + ("ic", "mae", "mse").index(ranking)] for row in expected], float)
    order = np.argsort(-np.round(scores, 9), kind="stable")
    found = stage.generate_hypotheses(case, config)
    assert len(found) == len(expected) > 5
    np.testing.assert_allclose(found.score, scores[order], atol=1e-8)
    assert found.num_inliers.tolist() == [expected[k][1] for k in order]
    np.testing.assert_allclose(found.T_target_source, [expected[k][0] for k in order], atol=1e-6)


@pytest.mark.parametrize("num", [63, 64, 65, 200])
def test_the_right_pose_comes_first(num):
    found = stage.generate_hypotheses(random_case(num), CONFIG)
    assert_same_pose(found.T_target_source[0], T_TRUE, 0.5, 0.1)
    assert (np.diff(found.score) <= 0).all()


def test_three_right_correspondences_are_enough():
    x = np.array([[0.0, 0, 0], [5, 0, 0], [0, 7, 0]])
    found = stage.generate_hypotheses(Correspondences.from_points(x, se3.apply(T_TRUE, x)), CONFIG)
    assert_same_pose(found.T_target_source[0], T_TRUE, 1e-5, 1e-5)
    assert found.num_inliers[0] == 3


@pytest.mark.parametrize("name", ["one_target", "one_point", "collinear"])
def test_what_determines_no_rotation_gives_no_pose(name):
    assert len(stage.generate_hypotheses(CASES[name], CONFIG)) == 0


@pytest.mark.parametrize("num", [0, 1, 2])
def test_too_few_correspondences_give_no_pose(num):
    x = np.arange(3.0 * num).reshape(num, 3)
    assert len(stage.generate_hypotheses(Correspondences.from_points(x, x), CONFIG)) == 0


def test_seeds_are_limited_but_never_padded():
    points = np.arange(300.0).reshape(100, 3) * 10
    confidence = np.linspace(0, 1, 100)
    assert stage.select_seeds(points, confidence, CONFIG).tolist() == list(range(99, 79, -1))
    few = dataclasses.replace(CONFIG, max_seeds=5)
    assert stage.select_seeds(points, confidence, few).tolist() == [99, 98, 97, 96, 95]
    one_hill = dataclasses.replace(CONFIG, nms_radius_m=99.0, seed_ratio=1.0)
    assert stage.select_seeds(points / 100, confidence, one_hill).tolist() == [99]


def test_the_same_correspondences_give_the_same_bits():
    first, second = (stage.generate_hypotheses(random_case(200), CONFIG) for _ in range(2))
    assert_same_bits(first.T_target_source, second.T_target_source)


def turned(sequence: str, *angles_deg: float) -> np.ndarray:
    turn = Rotation.from_euler(sequence, angles_deg, degrees=True).as_matrix().reshape(3, 3)  # a stack in older scipy
    return se3.make_pose(turn, (30.0, -5.0, 1.0))


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 179.9, 180.0, -30.0])
def test_turns_about_z_are_no_tilt(yaw_deg):
    upright = turned("z", yaw_deg)[None]
    assert_same_bits(stage.drop_tilted(upright, 0.0), upright)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(("tilt_deg", "stays"), [(9.99, True), (-9.99, True), (10.01, False), (-10.01, False),
                                                 (90.0, False), (170.0, False), (180.0, False)])  # fmt: skip
def test_a_pose_tilted_by_more_than_the_bound_is_dropped(axis, tilt_deg, stays):
    poses = np.array([turned("z" + axis, 70.0, tilt_deg), turned(axis + "z", tilt_deg, -140.0)])
    assert_same_bits(stage.drop_tilted(poses, 10.0), poses if stays else poses[:0])


def test_upside_down_wins_by_matches_but_not_where_gravity_is_known():
    x = np.random.default_rng(3).uniform(-20, 20, (100, 3)) * (1, 1, 0.2)
    flipped, upright = turned("x", 180.0), turned("zy", 60.0, 5.0)
    case = Correspondences.from_points(x, np.concatenate((se3.apply(flipped, x[:60]), se3.apply(upright, x[60:]))))
    every_seed = dataclasses.replace(CONFIG, seed_ratio=1.0)
    found = stage.generate_hypotheses(case, every_seed)
    level = stage.generate_hypotheses(case, dataclasses.replace(every_seed, gravity_aligned=True))
    assert_same_pose(found.T_target_source[0], flipped, 1e-5, 1e-5)
    assert_same_pose(level.T_target_source[0], upright, 1e-5, 1e-5)
    stays = found.T_target_source[:, 2, 2] > np.cos(np.radians(10.0))
    assert_same_bits(level.T_target_source, found.T_target_source[stays])  # and nothing else changes
    assert level.num_inliers.tolist() == found.num_inliers[stays].tolist()


def test_no_upright_hypothesis_is_no_hypothesis():
    x = random_case(64).source_points
    case = Correspondences.from_points(x, se3.apply(turned("y", 40.0), x))
    assert len(stage.generate_hypotheses(case, CONFIG)) > 0
    assert len(stage.generate_hypotheses(case, dataclasses.replace(CONFIG, gravity_aligned=True))) == 0


def test_pooled_hypotheses_are_those_of_both_thresholds_best_first():
    case = random_case(200)
    config = HypothesisConfig(compatibility_threshold_m=0.1, inlier_threshold_m=0.6)
    pooled = stage.pool_hypotheses(case, config)
    each = [
        stage.generate_hypotheses(case, dataclasses.replace(config, compatibility_threshold_m=limit))
        for limit in (0.1, 0.6)
    ]
    assert len(pooled) == sum(map(len, each))
    assert (np.diff(pooled.score) <= 0).all()
    for one in each:
        for T in one.T_target_source[:5]:
            assert (np.abs(pooled.T_target_source - T).max((1, 2)) == 0).any()


def test_a_threshold_as_wide_as_the_inliers_is_not_pooled_twice():
    case = random_case(200)
    config = HypothesisConfig(compatibility_threshold_m=0.6, inlier_threshold_m=0.6)
    assert len(stage.pool_hypotheses(case, config)) == len(stage.generate_hypotheses(case, config))
