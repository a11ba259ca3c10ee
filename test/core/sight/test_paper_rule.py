"""The published algorithms, count by count equal to all pairs without a tree."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference
from scan_cases import prepared, random_scan, real_pair, thin

from svc_ros.core import se3
from svc_ros.core.config import PaperConfig
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.sight import paper_rule

INDOORS = PaperConfig(tolerance_m=0.1)
OUTDOORS = PaperConfig(tolerance_m=0.6)


def check_against_all_pairs(observer: PreparedScan, placed: np.ndarray, config: PaperConfig) -> int:
    found = paper_rule.find_blocked(observer, placed, config)
    origin = observer.sensor_origin
    in_roi, blocked, blockers = reference.paper_blocked(
        observer.points - origin, placed - origin, config.tolerance_m, config.cone_cosine
    )
    assert (found.num_lines, found.num_observed) == (len(observer), in_roi)
    np.testing.assert_array_equal(found.blocked_idx, blocked)
    np.testing.assert_array_equal(found.blocker_idx, blockers)
    return len(blocked)


@pytest.mark.parametrize("cosine", [0.99997, 0.999, 0.9])
@pytest.mark.parametrize("seed", range(4))
def test_blocked_lines_of_random_scans_equal_all_pairs(seed, cosine):
    config = dataclasses.replace(OUTDOORS, cone_cosine=cosine)
    observer, other = random_scan(400, seed), random_scan(500, seed + 50)
    assert check_against_all_pairs(observer, other.points, config) > 0 or cosine > 0.999
    check_against_all_pairs(random_scan(300, seed, origin=(3, -2, 1)), other.points, config)


@pytest.mark.parametrize(
    ("name", "config"), [("os1_64_seosan", OUTDOORS), ("hdl64_kitti_a", OUTDOORS), ("rgbd_redkitchen", INDOORS)]
)
def test_blocked_lines_of_real_scans_equal_all_pairs(shared_data, name, config):
    source, target, T, settings = real_pair(shared_data, name, index=2)
    source, target = (thin(preprocess(scan, settings.preprocess), 1500) for scan in (source, target))
    shifted = T @ se3.make_pose(np.eye(3), (1.5, 0.7, 0.2))
    total = 0
    for pose in (T, shifted):
        total += check_against_all_pairs(target, se3.apply(pose, source.points), config)
        total += check_against_all_pairs(source, se3.apply(se3.invert(pose), target.points), config)
    assert total > 10


def test_both_ways_are_the_two_directions():
    source, target = random_scan(300, 1), random_scan(400, 2, origin=(1, 0, 0))
    T = se3.make_pose(np.eye(3), (0.5, -0.5, 0.1))
    config = dataclasses.replace(OUTDOORS, cone_cosine=0.999)
    in_target, in_source, passed = paper_rule.check_both_ways(source, target, T, config)
    there = paper_rule.find_blocked(target, se3.apply(T, source.points), config)
    back = paper_rule.find_blocked(source, se3.apply(se3.invert(T), target.points), config)
    np.testing.assert_array_equal(in_target.blocked_idx, there.blocked_idx)
    np.testing.assert_array_equal(in_source.blocked_idx, back.blocked_idx)
    assert passed is (paper_rule.passes(there, config) and paper_rule.passes(back, config))


def wall(distance: float, half_width: float = 3.0) -> np.ndarray:
    """Points of a wall across the x axis."""
    y, z = np.meshgrid(*[np.arange(-half_width, half_width, 0.03 * distance)] * 2)
    return np.column_stack([np.full(y.size, distance), y.ravel(), z.ravel()])


def test_scans_that_overlap_everywhere_block_nothing():
    observer = prepared(wall(5.0))
    found = paper_rule.find_blocked(observer, observer.points + np.array([0.05, 0, 0]), INDOORS)
    assert (found.num_lines, found.num_observed, found.num_blocked) == (len(observer), 0, 0)
    assert paper_rule.passes(found, INDOORS)


def test_nothing_in_the_region_of_interest_blocks_nothing():
    found = paper_rule.find_blocked(prepared(wall(5.0)), wall(3.0) * (-1, 1, 1), INDOORS)
    assert (found.num_observed, found.num_blocked) == (0, 0)
    assert paper_rule.passes(found, INDOORS)


def test_a_wall_before_the_wall_blocks_and_one_behind_does_not():
    observer = prepared(wall(5.0))
    before = paper_rule.find_blocked(observer, observer.points * 0.6, INDOORS)
    assert before.num_blocked == before.num_observed == len(observer)
    np.testing.assert_array_equal(before.blocker_idx, np.arange(len(observer)))
    assert not paper_rule.passes(before, INDOORS)
    behind = paper_rule.find_blocked(observer, observer.points * 1.4, INDOORS)
    assert (behind.num_observed, behind.num_blocked) == (len(observer), 0)


def test_the_bound_is_strict():
    lines = paper_rule.SightLines(100, 50, np.arange(2), np.arange(2))
    assert not paper_rule.passes(lines, PaperConfig(max_blocked_ratio=0.02))
    assert paper_rule.passes(lines, PaperConfig(max_blocked_ratio=0.021))


def test_a_point_at_the_sensor_does_no_harm():
    observer = prepared(wall(5.0))
    found = paper_rule.find_blocked(observer, np.zeros((1, 3)), INDOORS)
    assert found.num_blocked == 0
