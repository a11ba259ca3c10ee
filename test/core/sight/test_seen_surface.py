"""What a sensor saw of placed surface: equal to the slow twin, and denied where it looked through, nowhere else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_images as reference
from assertions import assert_same_bits
from image_cases import CASES, MIN_RANGE, cells_of, raster
from scan_cases import prepared, random_scan, real_pair
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import SightViewConfig
from svc_ros.core.range_image import build_range_image
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.search.prescore import thinned_scan
from svc_ros.core.sight.evidence import SeenSurface
from svc_ros.core.sight.placement import place
from svc_ros.core.sight.seen_surface import look_through
from svc_ros.core.sight.sight_view import gather_evidence, glance

CONFIG = SightViewConfig(tolerance_m=0.6, denied_margin=0.5, denied_margin_per_range=0.01, wide_cluster_deg=30.0)
POSE = se3.make_pose(Rotation.from_euler("zyx", [50, 8, -4], degrees=True).as_matrix(), (1.0, -2.0, 0.3))


def with_image(scan: PreparedScan, raw: Array | None = None, spacing_deg: float = 0.5) -> PreparedScan:
    """The scan with the range image of raw points, by default its own."""
    raw = scan.points if raw is None else raw
    image = build_range_image(raw, scan.sensor_origin, MIN_RANGE, spacing_deg)
    return dataclasses.replace(scan, range_image=image, memo={})


def look(observer: PreparedScan, other: PreparedScan, T: Array | None = None, config=CONFIG) -> SeenSurface:
    return look_through(observer, place(observer, other, np.eye(4) if T is None else T, config), config)


def counts_of(seen: SeenSurface) -> tuple[int, ...]:
    return seen.num_confirmed, seen.num_denied, seen.num_hidden, seen.num_unseen


# Against the twin


def check_look(observer: PreparedScan, other: PreparedScan, T: Array, config: SightViewConfig) -> np.ndarray:
    """Compare with the twin; returns how many points are of each kind."""
    placement, image = place(observer, other, T, config), observer.range_image
    placed = other.points @ T[:3, :3].T + T[:3, 3] - observer.sensor_origin
    cell = np.full(len(placed), -1)
    away = np.linalg.norm(placed, axis=1) > 0
    cell[away] = cells_of(placed[away], image.tables)[0]
    cosine = np.full(len(placed), np.nan)
    on = np.flatnonzero(placement.nearest >= 0)
    turned = se3.rotate(T, other.normals)
    cosine[on] = np.einsum("ij,ij->i", turned[on], observer.normals[placement.nearest[on]])
    limits = config.denied_margin * config.tolerance_m, config.denied_margin_per_range, config.same_side_cosine
    kinds = reference.look(placed, cosine, cell, (image.near, image.far), limits)
    seen = look_through(observer, placement, config)
    num = np.bincount(kinds, minlength=5)
    expected = tuple(num[[reference.CONFIRMED, reference.DENIED, reference.HIDDEN, reference.UNSEEN]])
    assert (seen.num_points, counts_of(seen)) == (len(other), expected)
    denied = np.flatnonzero(kinds == reference.DENIED)
    np.testing.assert_array_equal(seen.denied_idx, denied)
    labels = reference.clusters(placed[denied], 2.0 * other.voxel_size_m)
    weighed = reference.sum_by_extent(placed[denied], labels, np.radians(config.wide_cluster_deg))
    assert seen.wide_denied == pytest.approx(weighed)
    return num


@pytest.mark.parametrize("origin", [(0, 0, 0), (2.0, -1.0, 0.5)])
@pytest.mark.parametrize("spacing_deg", [0.5, 2.0])
def test_random_scans_are_seen_as_by_the_twin(origin, spacing_deg):
    total = np.zeros(5, int)
    for seed in range(3):
        observer = with_image(random_scan(6000, seed, origin=origin), spacing_deg=spacing_deg)
        for T in (POSE, np.eye(4)):
            total += check_look(observer, random_scan(3000, seed + 9, origin=origin), T, CONFIG)
    assert total.min() > 20, total


@pytest.mark.parametrize("case", [name for name in CASES if not name.startswith("beyond")])
def test_odd_scans_are_seen_as_by_the_twin(case):
    """Observed as they are, and with scans as odd as they placed before them."""
    raw, turned = CASES[case], se3.make_pose(np.eye(3), (0.05, -0.02, 0.01))
    raw = raw[:: max(1, len(raw) // 3000)]
    normals = np.tile([0.0, 0.6, -0.8], (len(raw), 1))
    everywhere = with_image(random_scan(5000, 4), spacing_deg=2.0)
    other = prepared(raw, normals)
    check_look(everywhere, other, turned, CONFIG)
    check_look(everywhere, other, np.eye(4), CONFIG)
    if len(raw):
        observer = with_image(other, CASES[case])
        check_look(observer, random_scan(800, 5), turned, CONFIG)
        check_look(observer, other, turned, CONFIG)


@pytest.mark.parametrize("tiny", [0.0, 1e-300, 1e-170, 1e-12])
def test_a_point_at_the_sensor_has_no_direction(tiny):
    observer = with_image(prepared(10.0 * raster(np.arange(-180, 180, 0.4), np.arange(-80, 81, 0.4))))
    seen = look(observer, prepared([[tiny, -tiny, tiny]], [[1.0, 0, 0]]))
    assert counts_of(seen) == ((0, 1, 0, 0) if tiny == 1e-12 else (0, 0, 0, 1))


def test_random_real_poses_are_seen_as_by_the_twin(shared_data):
    source, target, T, config = real_pair(shared_data, "vlp16_hand_held")
    source, target = (preprocess(scan, config.preprocess) for scan in (source, target))
    thinned = thinned_scan(source, 3000)
    for sideways in (0.0, 1.0, 4.0):
        check_look(target, thinned, T @ se3.make_pose(np.eye(3), (0, sideways, 0)), config.sight_view)


# Behaviour


def wall(range_m: float, half_width: float = 0.35, step: float = 0.01, centre_deg: float = 0.0) -> PreparedScan:
    """Plane across the x axis, turned about z; half as wide as its range times `half_width` each way."""
    y, z = (v.ravel() for v in np.meshgrid(*[np.arange(-half_width, half_width, step)] * 2))
    turn = Rotation.from_euler("z", centre_deg, degrees=True)
    points = turn.apply(range_m * np.column_stack([np.ones_like(y), y, z]))
    return prepared(points, turn.apply(np.tile((-1.0, 0, 0), (len(points), 1))))


@pytest.fixture(scope="module")
def room() -> PreparedScan:
    """A sensor before a wall at 10 m."""
    return with_image(wall(10.0, step=0.005))


def test_a_wall_before_a_wall_is_denied_behind_it_is_hidden_and_beside_it_is_not_looked_at(room):
    before, behind, beside = wall(6.0, 0.3, 0.02), wall(15.0, 0.3, 0.02), wall(6.0, 0.3, 0.02, centre_deg=90.0)
    num = len(before)
    assert counts_of(look(room, before)) == (0, num, 0, 0)
    assert counts_of(look(room, behind)) == (0, 0, num, 0)
    assert counts_of(look(room, beside)) == (0, 0, 0, num)
    assert look(room, before).denied_ratio == 1.0
    assert look(room, behind).denied_ratio == look(room, beside).denied_ratio == 0.0


def test_a_wall_on_the_wall_is_confirmed_from_its_own_side_only(room):
    front = wall(10.0, 0.3, 0.02)
    back = prepared(front.points, -front.normals)
    assert counts_of(look(room, front)) == (len(front), 0, 0, 0)
    assert counts_of(look(room, back)) == (0, 0, 0, 0)


@pytest.mark.parametrize(("margin", "per_range"), [(0.5, 0.0), (2.0, 0.0), (0.5, 0.05), (0.0, 0.1)])
def test_denied_is_what_stands_before_by_more_than_the_margins(margin, per_range):
    """A shell, which has one range in all directions; the tolerance is small, so that nothing lies on it."""
    config = dataclasses.replace(CONFIG, tolerance_m=0.2, denied_margin=margin, denied_margin_per_range=per_range)
    shell = with_image(prepared(10.0 * raster(np.arange(-180, 180, 0.4), np.arange(-30, 30, 0.4))))
    border = (10.0 - 0.2 * margin) / (1.0 + per_range)
    for range_m in (border - 0.01, border + 0.01, 9.79, 8.0):
        other = prepared(range_m * raster(np.arange(-180, 180, 3.0), np.arange(-20, 20, 3.0)))
        denied = look(shell, other, config=config).num_denied
        assert denied == (len(other) if range_m < border and range_m < 9.8 else 0), range_m


def ground(elevation_deg: np.ndarray) -> PreparedScan:
    """Level ground as a spinning sensor 1.7 m above it sees it, in rings."""
    points = raster(np.arange(-180, 180, 0.2), elevation_deg)
    points *= (-1.7 / points[:, 2])[:, None]
    return prepared(points, np.tile((0.0, 0, 1), (len(points), 1)))


def test_ground_between_two_rings_is_not_denied_at_the_true_pose():
    """Grazing: the rings are metres apart, farther than any tolerance."""
    rings = ground(np.arange(-15.0, -1.5, 1.0))
    observer = with_image(rings, spacing_deg=1.0)
    for between in (0.3, 0.5, 0.7):
        seen = look(observer, ground(np.arange(-14.0, -3.0, 1.0) + between))
        assert seen.num_denied == 0
        assert seen.num_unseen < 0.2 * seen.num_points
    for x in (1.0, 5.0):
        seen = look(observer, rings, se3.make_pose(np.eye(3), (x, 0.3, 0)))
        assert seen.num_denied == 0
        assert seen.num_confirmed > 1000
    lifted = look(observer, rings, se3.make_pose(np.eye(3), (0, 0, 1.2)))
    assert (
        lifted.num_denied == lifted.num_points - lifted.num_unseen > 0.3 * lifted.num_points
    )  # others stand above all beams


@pytest.mark.parametrize("lost", ["none", "below", "above", "own"])
def test_a_lost_row_says_nothing_about_the_rows_beside_it(lost):
    """A wall seen by beams 1.05 deg apart, each in the middle of its row of cells."""
    height = 1.05
    rows = (np.arange(75, 95) + 0.5) * height - 90.0
    missing = {"none": [], "below": [9], "above": [11], "own": [10]}[lost]
    beams = np.delete(rows, missing)
    observer = with_image(prepared(10.0 * raster(np.arange(-40, 40, 0.2), beams)), spacing_deg=1.0)
    assert observer.range_image.size_deg == pytest.approx((height, 0.4))
    seen = look(observer, prepared(5.0 * raster(np.arange(-30, 30, 1.0), rows[[10]])))
    assert counts_of(seen) == ((0, 60, 0, 0) if lost == "none" else (0, 0, 0, 60))


def test_a_lost_column_changes_nothing():
    """One of nine cells may be empty: glass, a wet spot, a beam that the carrier hides."""
    azimuth = np.arange(-40, 40, 0.2)
    whole = raster(azimuth, np.arange(-10, 10, 0.4))
    holed = raster(azimuth[(azimuth < 0.0) | (azimuth > 0.5)], np.arange(-10, 10, 0.4))
    other = prepared(5.0 * raster(np.arange(-30, 30, 0.1), np.arange(-8, 8, 1.0)))
    whole, holed = (look(with_image(prepared(10.0 * raw)), other) for raw in (whole, holed))
    assert holed.num_denied == whole.num_denied == len(other)


def test_edges_are_covered_by_what_the_sensor_saw_beside_them():
    """A post before a wall: surface at the post's range, a cell beside its edge, is no contradiction."""
    raw = raster(np.arange(-20, 20, 0.1), np.arange(-10, 10, 0.2))
    azimuth = np.degrees(np.arctan2(raw[:, 1], raw[:, 0]))
    raw = raw * np.where(np.abs(azimuth) < 1.0, 5.0, 10.0)[:, None]
    observer = with_image(prepared(raw))
    for beside_deg, denied in ((1.2, False), (2.5, True)):
        seen = look(observer, prepared(5.0 * raster(np.array([beside_deg, -beside_deg]), np.arange(-8, 8, 0.5))),
                    config=dataclasses.replace(CONFIG, tolerance_m=0.01))  # fmt: skip
        assert seen.num_denied == (seen.num_points if denied else 0)


def test_a_small_box_that_moved_counts_less_than_a_wide_wall_of_as_many_points(room):
    wide = wall(5.0, 0.3, 0.02)
    box = prepared(wide.points * [1.0, 0.1, 0.1], wide.normals)
    for other in (wide, box):
        assert look(room, other).num_denied == len(wide)
    assert look(room, wide).wide_denied == len(wide)
    assert look(room, box).wide_denied < 0.2 * len(wide)
    both = prepared(np.vstack([wide.points, box.points - [2.0, 0, 0]]), np.vstack([wide.normals, box.normals]))
    weighed = look(room, both).wide_denied  # clusters apart, each by its own angle
    assert len(wide) < weighed < 1.3 * len(wide)


@pytest.mark.parametrize("wide_deg", [1.0, 10.0, 30.0, 180.0])
def test_the_angle_of_a_wide_cluster_is_a_setting(room, wide_deg):
    config = dataclasses.replace(CONFIG, wide_cluster_deg=wide_deg)
    other = wall(5.0, 0.1, 0.01)  # 0.2 wide and high at 1: 16 deg from corner to corner
    share = look(room, other, config=config).wide_denied / len(other)
    assert share == pytest.approx(min(1.0, 16.2 / wide_deg), rel=0.1)


def test_without_a_range_image_nothing_is_denied_nor_confirmed(room):
    blind = dataclasses.replace(room, range_image=None, memo={})
    for other in (room, wall(5.0)):
        seen = look(blind, other)
        assert (counts_of(seen), seen.wide_denied) == ((0, 0, 0, len(other)), 0.0)
    evidence = glance(blind, blind, np.eye(4), CONFIG)
    assert (evidence.denied_ratio, evidence.wide_denied_ratio, evidence.overlap_ratio) == (0.0, 0.0, 1.0)


def test_a_thinned_scan_keeps_the_range_image_of_all_its_points(room):
    """And says about what the whole one says, of both as observers and as what is placed."""
    few, before = thinned_scan(room, 2000), wall(6.0, 0.3, 0.01)
    assert few.range_image is room.range_image
    assert len(few) < 0.2 * len(room)
    np.testing.assert_array_equal(look(few, before).denied_idx, look(room, before).denied_idx)
    closer = se3.make_pose(np.eye(3), (-3.0, 0, 0))
    whole, thin = (look(room, other, closer) for other in (room, few))
    assert thin.num_denied / len(few) == pytest.approx(whole.num_denied / len(room), abs=0.05)
    assert thin.wide_denied / len(few) == pytest.approx(whole.wide_denied / len(room), abs=0.05)


def test_the_order_of_points_does_not_matter():
    observer, other = with_image(random_scan(5000, 1), spacing_deg=2.0), random_scan(2000, 2)
    seen = look(observer, other, POSE)
    rng = np.random.default_rng(0)
    a, b = rng.permutation(len(observer)), rng.permutation(len(other))
    again = look(
        with_image(prepared(observer.points[a], observer.normals[a]), spacing_deg=2.0),
        prepared(other.points[b], other.normals[b]), POSE,
    )  # fmt: skip
    assert counts_of(again) == counts_of(seen)
    assert seen.num_denied > 100
    np.testing.assert_array_equal(np.sort(b[again.denied_idx]), seen.denied_idx)


def test_exchanged_scans_are_seen_alike():
    source = with_image(random_scan(5000, 1), spacing_deg=2.0)
    target = with_image(random_scan(4000, 2, origin=(1, 1, 0)), spacing_deg=1.0)
    there, back = (glance(*scans, CONFIG) for scans in ((source, target, POSE), (target, source, se3.invert(POSE))))
    for one, other in ((there.source_surface, back.target_surface), (there.target_surface, back.source_surface)):
        assert counts_of(one) == counts_of(other)
        assert one.num_denied > 0
        assert_same_bits(one.denied_idx, other.denied_idx)
        assert one.wide_denied == pytest.approx(other.wide_denied)
    assert there.denied_ratio == back.denied_ratio
    assert there.wide_denied_ratio == pytest.approx(back.wide_denied_ratio)


# Real scans


@pytest.mark.parametrize("name", ["os1_64_seosan", "vlp16_hand_held"])
def test_of_a_real_pair_little_is_denied_and_of_a_slip_much(shared_data, name):
    source, target, T, config = real_pair(shared_data, name)
    source, target = (preprocess(scan, config.preprocess) for scan in (source, target))
    right = glance(source, target, T, config.sight_view)
    assert right.denied_ratio < 0.05
    across = [se3.make_pose(np.eye(3), shift) @ T for shift in ((0, 3.0, 0), (0, -3.0, 0))]
    for pose in across:
        wrong = glance(source, target, pose, config.sight_view)
        assert wrong.denied_ratio > max(0.1, 4.0 * right.denied_ratio)
        assert wrong.wide_denied_ratio > 4.0 * right.wide_denied_ratio
    whole = gather_evidence(source, target, T, config.sight_view)
    assert (whole.denied_ratio, whole.wide_denied_ratio) == (right.denied_ratio, right.wide_denied_ratio)
