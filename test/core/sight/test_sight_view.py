"""Sight lines of the default mode: equal to all pairs, everywhere on the sphere, and blind to what proves nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference
from scan_cases import prepared, random_scan, real_pair, thin
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import PaperConfig, SightViewConfig
from svc_ros.core.range_image import build_range_image
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.sight import paper_rule
from svc_ros.core.sight.sight_view import cone_half_angle_deg, gather_evidence, glance, index, look_both_ways


def fixed_cone(half_angle_deg: float, tolerance: float, radius: float, incidence_deg: float) -> SightViewConfig:
    """A cap of the cone that is the same for every sensor."""
    return SightViewConfig(
        tolerance_m=tolerance, beam_radius_voxels=radius, max_incidence_deg=incidence_deg,
        min_cone_deg=half_angle_deg, max_cone_deg=half_angle_deg,
    )  # fmt: skip


NARROW = fixed_cone(0.5, tolerance=0.4, radius=0.5, incidence_deg=85.0)
MIDDLE = fixed_cone(3.0, tolerance=0.6, radius=1.0, incidence_deg=85.0)
WIDE = fixed_cone(30.0, tolerance=0.1, radius=4.0, incidence_deg=60.0)
POSE = se3.make_pose(Rotation.from_euler("zyx", [50, 8, -4], degrees=True).as_matrix(), (1.0, -2.0, 0.3))


def check_lines(observer: PreparedScan, other: PreparedScan, T: np.ndarray, config: SightViewConfig, found) -> int:
    """Compare the observer's sight lines with those of all pairs; T places the other scan in its frame."""
    points, normals = se3.apply(T, other.points), se3.rotate(T, other.normals)
    alone = np.flatnonzero(reference.nearest_within(points, observer.points, config.tolerance_m) < 0)
    radius, origin = config.beam_radius_voxels * observer.voxel_size_m, observer.sensor_origin
    angles = np.radians([config.max_cone_deg, config.max_incidence_deg])
    limits = np.array([config.tolerance_m, radius, angles[0], np.tan(angles[1])])
    blocker, observed = reference.line_blockers(
        points[alone] - origin, normals[alone], observer.points - origin, observer.normals, limits
    )
    blocked = np.flatnonzero(blocker >= 0)
    assert (found.num_lines, found.num_observed) == (len(observer), observed.sum())
    np.testing.assert_array_equal(found.blocked_idx, blocked)
    np.testing.assert_array_equal(found.blocker_idx, alone[blocker[blocked]])
    return len(blocked)


def check_both_ways(source: PreparedScan, target: PreparedScan, T: np.ndarray, config: SightViewConfig) -> int:
    evidence = gather_evidence(source, target, T, config)
    return check_lines(target, source, T, config, evidence.source_in_target) + check_lines(
        source, target, se3.invert(T), config, evidence.target_in_source
    )


@pytest.mark.parametrize("config", [NARROW, MIDDLE, WIDE], ids=["narrow", "middle", "wide"])
@pytest.mark.parametrize("origin", [(0, 0, 0), (2.0, -1.0, 0.5)])
def test_blocked_lines_of_random_scans_equal_all_pairs(origin, config):
    num_blocked = 0
    for seed in range(3):
        source, target = random_scan(700, seed), random_scan(600, seed + 9, origin=origin)
        num_blocked += check_both_ways(source, target, POSE, config)
    assert num_blocked > 0


@pytest.mark.parametrize("name", ["os1_64_seosan", "hdl64_kitti_a"])
def test_blocked_lines_of_real_scans_equal_all_pairs(shared_data, name):
    source, target, T, settings = real_pair(shared_data, name)
    source, target = (thin(preprocess(scan, settings.preprocess), 1400) for scan in (source, target))
    shifted = T @ se3.make_pose(np.eye(3), (1.0, 1.0, 0.3))
    assert sum(check_both_ways(source, target, pose, MIDDLE) for pose in (T, shifted)) > 0


def around(axis: tuple[float, float, float], spread_deg: float, distance: float, seed: int) -> PreparedScan:
    """Points within an angle of one direction, at about one distance."""
    rng = np.random.default_rng(seed)
    directions = np.asarray(axis) + np.tan(np.radians(spread_deg)) * rng.uniform(-1, 1, (300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return prepared(directions * rng.uniform(0.95, 1.05, (300, 1)) * distance)


@pytest.mark.parametrize("config", [NARROW, MIDDLE, WIDE], ids=["narrow", "middle", "wide"])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (-1, 0, 0), (-1, 0, 0.5), (0.02, 0, 1), (-0.02, 1e-3, -1)])
def test_lines_at_the_poles_and_across_the_seam_are_found(axis, config):
    near, far = around(axis, 2.0, 3.0, 1), around(axis, 2.0, 9.0, 2)
    evidence = gather_evidence(near, far, np.eye(4), config)
    num_blocked = check_lines(far, near, np.eye(4), config, evidence.source_in_target)
    assert num_blocked > 50
    check_lines(near, far, np.eye(4), config, evidence.target_in_source)


def test_lines_are_counted_the_same_wherever_they_point():
    near, far = around((1, 0, 0), 2.0, 3.0, 1), around((1, 0, 0), 2.0, 9.0, 2)
    counts = []
    for rotation in Rotation.random(20, random_state=4):
        T = se3.make_pose(rotation.as_matrix(), (0, 0, 0))
        turned = [prepared(se3.apply(T, s.points), se3.rotate(T, s.normals)) for s in (near, far)]
        counts.append(gather_evidence(*turned, np.eye(4), MIDDLE).source_in_target.num_blocked)
    assert set(counts) == {gather_evidence(near, far, np.eye(4), MIDDLE).source_in_target.num_blocked}


def wall(distance: float) -> PreparedScan:
    y, z = np.meshgrid(*[np.arange(-2.0, 2.0, 0.02 * distance)] * 2)
    points = np.column_stack([np.full(y.size, distance), y.ravel(), z.ravel()])
    return prepared(points, np.tile((-1.0, 0, 0), (len(points), 1)))


@pytest.mark.parametrize("config", [NARROW, MIDDLE, WIDE], ids=["narrow", "middle", "wide"])
def test_a_wall_that_moves_to_the_front_blocks(config):
    scan = wall(8.0)
    closer = se3.make_pose(np.eye(3), (-2.0, 0, 0))
    evidence = gather_evidence(scan, scan, closer, config)
    assert evidence.source_in_target.blocked_ratio > (0.05 if config is NARROW else 0.5)
    assert evidence.target_in_source.num_blocked == 0  # from the source's own place the target's wall is behind
    assert evidence.target_in_source.num_observed > 0
    assert evidence.overlap_ratio == 0


def test_the_nearest_of_several_walls_is_the_blocker():
    three = [wall(d) for d in (6.0, 3.0, 4.0)]
    other = prepared(np.concatenate([w.points for w in three]), np.concatenate([w.normals for w in three]))
    lines = gather_evidence(other, wall(9.0), np.eye(4), WIDE).source_in_target
    assert lines.num_blocked > 100
    assert (np.linalg.norm(other.points[lines.blocker_idx], axis=1) < 5.0).all()
    assert (other.points[lines.blocker_idx, 0] == 3.0).all()


def rings(ranges: list[float], sensor_height: float = 1.7) -> PreparedScan:
    """Level ground as a spinning sensor sees it: circles, far apart where the rays graze."""
    azimuth = np.radians(np.arange(0, 360, 0.2))
    points = [np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), 0 * azimuth - sensor_height]) for r in ranges]
    return prepared(np.concatenate(points), np.tile((0.0, 0, 1), (len(ranges) * len(azimuth), 1)))


def test_ground_between_two_rings_contradicts_nothing():
    target, source = rings([20.0, 26.0, 34.0, 48.0]), rings([23.0, 30.0, 40.0])
    lines = gather_evidence(source, target, np.eye(4), MIDDLE).source_in_target
    assert lines.num_blocked == 0
    published = paper_rule.find_blocked(target, source.points, PaperConfig(tolerance_m=0.6))
    assert published.blocked_ratio > 0.1  # which is why it is not the default


def test_a_scan_laid_on_itself_agrees_with_itself():
    scan = wall(6.0)
    evidence = gather_evidence(scan, scan, np.eye(4), MIDDLE)
    assert (evidence.overlap_ratio, evidence.oriented_overlap_ratio, evidence.opposed_ratio) == (1.0, 1.0, 0.0)
    assert (evidence.source_in_target.num_blocked, evidence.target_in_source.num_blocked) == (0, 0)


def test_a_surface_seen_from_both_sides_is_opposed():
    front = wall(6.0)
    back = prepared(front.points, -front.normals)
    evidence = gather_evidence(back, front, np.eye(4), MIDDLE)
    assert (evidence.overlap_ratio, evidence.oriented_overlap_ratio, evidence.opposed_ratio) == (1.0, 0.0, 1.0)


def test_overlap_is_the_smaller_of_both_directions():
    whole = wall(6.0)
    half = prepared(whole.points[whole.points[:, 1] < 0], whole.normals[whole.points[:, 1] < 0])
    evidence = gather_evidence(half, whole, np.eye(4), NARROW)
    assert 0.45 < evidence.overlap_ratio < 0.75
    assert evidence.overlap_ratio == gather_evidence(whole, half, np.eye(4), NARROW).overlap_ratio


def test_a_point_at_the_sensor_is_no_line():
    """It has no direction; grids put it where the x axis points."""
    scan = wall(6.0)
    holder = prepared(np.vstack([scan.points, np.zeros(3)]), np.vstack([scan.normals, [-1.0, 0, 0]]))
    closer = se3.make_pose(np.eye(3), (-3.0, 0, 0))
    found = gather_evidence(scan, holder, closer, WIDE).source_in_target
    np.testing.assert_array_equal(
        found.blocked_idx, gather_evidence(scan, scan, closer, WIDE).source_in_target.blocked_idx
    )


def test_scans_without_contact_say_nothing():
    evidence = gather_evidence(wall(6.0), wall(6.0), se3.make_pose(np.eye(3), (0, 0, -500)), MIDDLE)
    assert evidence.overlap_ratio == evidence.oriented_overlap_ratio == evidence.opposed_ratio == 0
    assert evidence.source_in_target.num_observed == evidence.target_in_source.num_observed == 0


def test_exchanged_scans_give_exchanged_evidence():
    source, target = random_scan(700, 1), random_scan(600, 2, origin=(1, 1, 0))
    there, back = (
        gather_evidence(*pair, WIDE) for pair in ((source, target, POSE), (target, source, se3.invert(POSE)))
    )
    for one, other in (
        (there.source_in_target, back.target_in_source),
        (there.target_in_source, back.source_in_target),
    ):
        assert one.num_blocked > 0
        assert (one.num_lines, one.num_observed) == (other.num_lines, other.num_observed)
        np.testing.assert_array_equal(one.blocked_idx, other.blocked_idx)
        np.testing.assert_array_equal(one.blocker_idx, other.blocker_idx)
    assert there.overlap_ratio == back.overlap_ratio
    assert there.oriented_overlap_ratio == back.oriented_overlap_ratio


@pytest.mark.parametrize(
    ("spacing_deg", "expected"), [(0.0, 0.25), (0.1, 0.25), (0.4, 0.3), (1.0, 0.75), (2.0, 1.5), (9.0, 1.5)]
)
def test_the_cone_is_a_share_of_the_beam_spacing_within_bounds(spacing_deg, expected):
    config = SightViewConfig(cone_beams=0.75, min_cone_deg=0.25, max_cone_deg=1.5)
    scan = PreparedScan(np.ones((1, 3)), np.ones((1, 3)), np.zeros(3), 0.3, beam_spacing_deg=spacing_deg)
    assert cone_half_angle_deg(scan, config) == pytest.approx(expected)


def test_what_is_blocked_was_observed_and_has_a_blocker_that_lies_on_nothing():
    for seed in range(3):
        source, target = random_scan(700, seed), random_scan(600, seed + 9)
        lines = gather_evidence(source, target, POSE, WIDE).source_in_target
        assert 0 < lines.num_blocked <= lines.num_observed <= lines.num_lines == len(target)
        placed = se3.apply(POSE, source.points[lines.blocker_idx])
        assert (reference.nearest_within(placed, target.points, WIDE.tolerance_m) < 0).all()


@pytest.mark.parametrize("kind", ["order", "motion"])
def test_what_is_seen_does_not_depend_on_how_scans_are_written_down(kind):
    """Prepared points in another order, or both scans in frames of their own, sensors moved as well."""
    source, target = random_scan(500, 1), random_scan(450, 2, origin=(1, 1, 0))
    expected = gather_evidence(source, target, POSE, WIDE)
    if kind == "order":
        rng = np.random.default_rng(0)
        orders = [rng.permutation(len(scan)) for scan in (source, target)]
        scans = [
            prepared(s.points[o], s.normals[o], s.sensor_origin) for s, o in zip((source, target), orders, strict=True)
        ]
        T = POSE
    else:
        motions = [se3.make_pose(R.as_matrix(), (5.0, -3, 1)) for R in Rotation.random(2, random_state=0)]
        scans = [prepared(se3.apply(M, s.points), se3.rotate(M, s.normals), se3.apply(M, s.sensor_origin[None])[0])
                 for s, M in zip((source, target), motions, strict=True)]  # fmt: skip
        T = motions[1] @ POSE @ se3.invert(motions[0])
    found = gather_evidence(*scans, T, WIDE)
    for name in ("overlap_ratio", "oriented_overlap_ratio", "opposed_ratio"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=1e-12)
    for way in ("source_in_target", "target_in_source"):
        one, other = getattr(found, way), getattr(expected, way)
        assert (one.num_lines, one.num_observed, one.num_blocked) == (
            other.num_lines, other.num_observed, other.num_blocked
        )  # fmt: skip


def lines_of(numbers: dict[str, float | int]) -> set[str]:
    """Names of what only the search along the sight lines tells."""
    return {name for name in numbers if name.startswith(("blocked_", "observed_", "num_blocked", "num_lines"))}


@pytest.mark.parametrize("kind", ["real", "random", "blind"])
def test_a_glance_is_the_evidence_without_the_lines(shared_data, kind):
    if kind == "real":
        source, target, T, settings = real_pair(shared_data, "os1_64_seosan")
        source, target = (preprocess(scan, settings.preprocess) for scan in (source, target))
        poses, config = [T @ se3.make_pose(np.eye(3), (x, 0, 0)) for x in (0.0, 1.0, 500.0)], settings.sight_view
    else:
        source, target, poses, config = random_scan(5000, 1, 4.0), random_scan(4000, 2, 4.0), [POSE], MIDDLE
        images = [build_range_image(s.points, s.sensor_origin, 0.1, 2.5) for s in (source, target)]
        if kind == "random":
            free = Rotation.random(3000, random_state=3).apply([1.0, 0, 0])
            source, target = (
                dataclasses.replace(s, range_image=image, free_directions=free, memo={})
                for s, image in zip((source, target), images, strict=True)
            )
    for pose in poses:
        quick, whole = (look(source, target, pose, config) for look in (glance, gather_evidence))
        numbers, expected = quick.numbers(), whole.numbers()
        assert all(numbers[name] == 0 for name in lines_of(numbers))
        assert len(lines_of(numbers)) == 8
        assert (numbers["num_free_blocked_source_in_target"] > 0) == (kind == "random")
        assert {n: numbers[n] for n in numbers.keys() - lines_of(numbers)} == {
            n: expected[n] for n in expected.keys() - lines_of(expected)
        }
        assert (quick.source_surface.num_confirmed > 0) == (kind != "blind" and quick.oriented_overlap_ratio > 0)
        for name in ("source_surface", "target_surface"):
            np.testing.assert_array_equal(getattr(quick, name).denied_idx, getattr(whole, name).denied_idx)


def test_both_ways_come_with_the_source_placed_in_the_targets_frame():
    source, target = random_scan(700, 1), random_scan(600, 2)
    evidence, in_target = look_both_ways(source, target, POSE, MIDDLE)
    assert in_target.other is source
    np.testing.assert_array_equal(in_target.T_observer_other, POSE)
    assert evidence.numbers() == gather_evidence(source, target, POSE, MIDDLE).numbers()
    assert (evidence.source_surface.num_points, evidence.target_surface.num_points) == (700, 600)


def test_indexing_builds_what_a_glance_needs_and_changes_nothing():
    source, target = random_scan(700, 1), random_scan(600, 2)
    expected = glance(random_scan(700, 1), random_scan(600, 2), POSE, MIDDLE).numbers()
    index((source, target), MIDDLE)
    grids = [scan.memo["nearest_grid", MIDDLE.tolerance_m] for scan in (source, target)]
    assert glance(source, target, POSE, MIDDLE).numbers() == expected
    for scan, grid in zip((source, target), grids, strict=True):
        assert scan.memo["nearest_grid", MIDDLE.tolerance_m] is grid
