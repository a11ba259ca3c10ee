"""Directions in which a sensor met nothing: equal to all pairs, only ever against a pose, and worth it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import reference
from scan_cases import prepared, random_scan, room_config, room_scans
from scipy.spatial.transform import Rotation
from simulated_scans import moved

from svc_ros.core import decision, se3
from svc_ros.core.config import DecisionConfig, SightViewConfig, preset
from svc_ros.core.errors import InputError
from svc_ros.core.registration import register
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.core.scans.preprocess import preprocess, thin_free_directions
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.sight_view import gather_evidence
from svc_ros.simulation.meshes import box, upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.scenes import build_scene
from svc_ros.simulation.sensors import lidar_model
from svc_ros.simulation.world import Scene, SceneConfig, SceneObject, Track

POSE = se3.make_pose(Rotation.from_euler("zyx", [50, 8, -4], degrees=True).as_matrix(), (1.0, -2.0, 0.3))
WIDE = SightViewConfig(tolerance_m=0.1, beam_radius_voxels=2.0, free_reach_m=12.0)


def directions(num: int, seed: int) -> np.ndarray:
    """Unit, all over the sphere."""
    vectors = np.random.default_rng(seed).normal(size=(num, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def with_free(scan: PreparedScan, free: np.ndarray) -> PreparedScan:
    return dataclasses.replace(scan, free_directions=free, memo={})


# The count


def check_count(observer: PreparedScan, other: PreparedScan, T: np.ndarray, config: SightViewConfig) -> int:
    """Compare with all pairs; T places the other scan in the observer's frame."""
    points, normals = se3.apply(T, other.points), se3.rotate(T, other.normals)
    alone = reference.nearest_within(points, observer.points, config.tolerance_m) < 0
    nearest = np.linalg.norm(observer.points - observer.sensor_origin, axis=1).min()
    radius = config.beam_radius_voxels * observer.voxel_size_m
    limits = (radius, np.radians(1.0), nearest, config.free_reach_m, math.cos(math.radians(config.max_incidence_deg)))
    met = reference.free_met(
        points[alone] - observer.sensor_origin, normals[alone], observer.free_directions, limits
    )  # fmt: skip
    lines = gather_evidence(other, observer, T, config).source_in_target
    assert (lines.num_free, lines.num_free_blocked) == (len(observer.free_directions), met.sum())
    return lines.num_free_blocked


@pytest.mark.parametrize("config", [SightViewConfig(), WIDE], ids=["preset", "wide"])
@pytest.mark.parametrize("origin", [(0, 0, 0), (2.0, -1.0, 0.5)])
def test_filled_directions_of_random_scans_equal_all_pairs(origin, config):
    counts = []
    for seed in range(3):
        observer = with_free(random_scan(300, seed, origin=origin), directions(3000, seed))
        counts.append(check_count(observer, random_scan(700, seed + 9), POSE, config))
    assert all(0 < count < 3000 for count in counts)


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (-1, 0, 0), (-1, 0, 0.5), (0.02, 0, 1), (-0.02, 1e-3, -1)])
def test_at_the_poles_and_across_the_seam_directions_are_found(axis):
    rng = np.random.default_rng(3)
    near = np.asarray(axis) + np.tan(np.radians(4.0)) * rng.uniform(-1, 1, (400, 3))
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    observer = with_free(prepared(-5.0 * near), near)
    assert check_count(observer, prepared(near[::4] * 8.0), np.eye(4), SightViewConfig()) > 50


def patch(distance: float, turn_deg: float = 0.0) -> PreparedScan:
    """A small dense surface ahead, turned about the vertical; seen by nobody in particular."""
    y, z = np.meshgrid(*[np.arange(-0.3, 0.3, 0.05)] * 2)
    flat = np.column_stack([np.zeros(y.size), y.ravel(), z.ravel()])
    turn = Rotation.from_euler("z", turn_deg, degrees=True)
    return prepared(turn.apply(flat) + np.array([distance, 0, 0]), turn.apply(np.tile((-1.0, 0, 0), (y.size, 1))))


@pytest.mark.parametrize(
    ("other", "fills"),
    [(patch(10.0), True), (patch(29.0), True), (patch(31.0), False), (patch(1.0), False),
     (patch(10.0, 60.0), True), (patch(25.0, 60.0), False), (patch(10.0, 88.0), False)],
    ids=["head_on", "at_reach", "beyond_reach", "blind_zone", "slanting", "slanting_far", "grazing"],
)  # fmt: skip
def test_only_surface_that_the_sensor_would_have_seen_counts(other, fills):
    observer = with_free(prepared([[-3.0, 0, 0], [0, -20.0, 0]]), np.array([[1.0, 0, 0], [0, 1.0, 0]]))
    lines = gather_evidence(other, observer, np.eye(4), SightViewConfig()).source_in_target
    assert (lines.num_free, lines.num_free_blocked) == (2, int(fills))


def test_what_lies_on_the_observers_own_surface_fills_nothing():
    surface = patch(10.0)
    observer = with_free(surface, np.array([[1.0, 0, 0]]))
    assert gather_evidence(surface, observer, np.eye(4), SightViewConfig()).source_in_target.num_free_blocked == 0


# From scan to prepared scan


def test_directions_are_thinned_to_a_degree_and_dropped_beside_a_return():
    free = directions(200_000, 1)
    origin, returns = np.array([1.0, 2.0, 3.0]), np.array([[4.0, 0, 0], [0, 0, 30.0]])
    scan = Scan(returns + origin, sensor_origin=origin, free_directions=free)
    thinned = thin_free_directions(scan)
    assert 41_253 / 2 < len(thinned) < 2 * 41_253  # square degrees of a sphere
    np.testing.assert_allclose(np.linalg.norm(thinned, axis=1), 1.0)
    for axis in np.eye(3)[[0, 2]]:
        angle = np.degrees(np.arccos(np.clip(thinned @ axis, -1, 1)))
        assert 0.99 < angle.min() < 2.0
    assert np.degrees(np.arccos((thinned @ (0.0, 1.0, 0.0)).max())) < 0.8
    shuffled = dataclasses.replace(scan, free_directions=np.random.default_rng(2).permutation(free))
    np.testing.assert_array_equal(thin_free_directions(shuffled), thinned)


def test_a_scan_that_tells_nothing_has_no_directions():
    points = np.random.default_rng(0).normal(size=(2000, 3)) * 8
    for free in (None, np.zeros((0, 3))):
        prepared_scan = preprocess(Scan(points, free_directions=free), preset("lidar_outdoor").preprocess)
        assert prepared_scan.free_directions.shape == (0, 3)


@pytest.mark.parametrize("free", [[[2.0, 0, 0]], [[0, 0, 0]], [[np.nan, 0, 0]], [[1.0, 0]]])
def test_directions_must_be_unit_vectors(free):
    with pytest.raises(InputError, match=r"Scan\.free_directions"):
        Scan(np.zeros((0, 3)), free_directions=np.array(free))


# The decision


def evidence(filled: int, num_free: int, overlap: float = 0.4, weakest: float = 0.3) -> SightViewEvidence:
    """Nothing else speaks against the pose: all surface that either sensor could see is confirmed."""
    nothing = np.zeros(0, np.int64)
    seen = SeenSurface(1000, 1000, nothing, 0.0, 0, 0)
    ways = [SightLines(1000, 500, nothing, nothing, num_free=n, num_free_blocked=b)
            for n, b in ((num_free, filled), (0, 0))]  # fmt: skip
    return SightViewEvidence(
        *ways, overlap, overlap, 0.0, weakest_constraint=weakest, source_surface=seen, target_surface=seen
    )  # fmt: skip


DECISION = DecisionConfig(
    offset=0.0, denied_weight=1.0, wide_denied_weight=1.0, structure_weight=2.0, max_free_blocked_per_overlap=0.15,
    min_free=100,
)  # fmt: skip


@pytest.mark.parametrize("weakest", [0.3, 0.05], ids=["plain", "weak"])
@pytest.mark.parametrize("overlap", [0.2, 0.4, 0.8])
def test_filled_free_space_rejects_beyond_the_border(overlap, weakest):
    config = DECISION
    border = config.max_free_blocked_per_overlap * overlap
    good, bad = (evidence(round(f * border * 10_000), 10_000, overlap, weakest) for f in (0.8, 1.2))
    assert decision.decide(good, config).verdict is Verdict.ACCEPTED
    refused = decision.decide(bad, config)
    assert (refused.verdict, refused.reason) == (Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
    assert "free space" in refused.detail


def test_few_directions_count_for_nothing():
    config = DECISION
    few, enough = (evidence(n, n) for n in (config.min_free - 1, config.min_free))
    assert decision.decide(few, config).verdict is Verdict.ACCEPTED
    assert decision.decide(enough, config).verdict is Verdict.REJECTED


def test_free_space_never_makes_a_margin_larger():
    config = DECISION
    for overlap in (0.05, 0.2, 0.6):
        for weakest in (0.05, 0.3):
            silent = evidence(0, 0, overlap, weakest)
            for filled in (0, 1, 10, 1000):
                telling = evidence(filled, 1000, overlap, weakest)
                without, beside = (decision.measure_margins(e, config) for e in (silent, telling))
                assert beside.free <= without.free
                assert (beside.same_side, beside.overlap) == (without.same_side, without.overlap)


def test_a_rival_that_fills_free_space_is_less_likely_than_one_of_which_nothing_is_told():
    judged, silent, filling = evidence(0, 0), evidence(0, 0), evidence(900, 1000)
    decided = decision.decide(judged, DECISION)
    for rival, reason in ((silent, Reason.AMBIGUOUS), (filling, Reason.OK)):
        assert decision.doubt(decided, judged, decision.Doubts([rival], [], []), DECISION).reason is reason


def test_without_free_directions_nothing_changes():
    """Bit for bit, whatever the settings of free space."""
    source, target = room_scans()
    plain = register(source, target, room_config())
    strict = room_config(
        sight_view__free_reach_m=1e4, decision__max_free_blocked_per_overlap=1e-3, decision__min_free=1
    )  # fmt: skip
    again = register(*(dataclasses.replace(s, free_directions=np.zeros((0, 3))) for s in (source, target)), strict)
    assert plain.accepted
    np.testing.assert_array_equal(plain.T_target_source, again.T_target_source)
    assert plain.evidence.numbers() == again.evidence.numbers()
    assert (plain.probability, plain.detail) == (again.probability, again.detail)


# What it is worth


def open_corridor(back_m: float, ahead_m: float, closed: bool) -> RayCaster:
    """2.6 m wide and 2.8 m high, with nothing beyond its ends but, where closed, a wall behind."""
    whole, middle = back_m + ahead_m, 0.5 * (ahead_m - back_m)
    slabs = [((whole, 2.6, 0.2), (middle, 0.0, -0.2)), ((whole, 2.6, 0.2), (middle, 0.0, 2.8))]
    slabs += [((whole, 0.2, 2.8), (middle, side * 1.4, 0.0)) for side in (-1, 1)]
    slabs += [((0.2, 2.6, 2.8), (-back_m, 0.0, 0.0))] if closed else []
    for x, side in ((-5.0, 1), (-1.5, -1), (2.0, 1), (5.5, -1), (9.0, -1)):  # boxes along the walls
        slabs.append(((0.5, 0.3, 1.4), (x, side * 1.15, 0.0)))
    way = np.column_stack([np.arange(0.0, 5.0, 0.1), np.zeros(50)])
    track = Track.on_ground(way, lambda x, y: np.zeros_like(x))
    return RayCaster(Scene("corridor", tuple(SceneObject("wall", box(*s)) for s in slabs), track, 1.2))


def scans_in(caster: RayCaster, poses: list[np.ndarray], sensor: str) -> list[Scan]:
    model = lidar_model(sensor)
    return [caster.cast(T, model, np.random.default_rng(k)).scan(tell_free=True) for k, T in enumerate(poses)]


def both_verdicts(scans: list[Scan], T: np.ndarray, preset_name: str) -> tuple[Verdict, Verdict]:
    """Verdict on a pose with what the sensors tell, and without."""
    silent = [dataclasses.replace(scan, free_directions=None) for scan in scans]
    config = preset(preset_name)
    told, untold = ([preprocess(scan, config.preprocess) for scan in pair] for pair in (scans, silent))
    seen, unseen = (gather_evidence(source, target, T, config.sight_view) for target, source in (told, untold))
    assert seen.source_in_target.num_free > config.decision.min_free
    assert unseen.source_in_target.num_free == 0
    return decision.decide(seen, config.decision).verdict, decision.decide(unseen, config.decision).verdict


def test_a_simulated_sensor_tells_every_firing_without_a_return():
    """Also lost ones: it cannot know. Nothing nearer than its smallest range."""
    sensor = dataclasses.replace(lidar_model("VLP-16"), min_range_m=3.0)
    cast = open_corridor(8.0, 12.0, True).cast(upright(0.0, 0.0, 1.2), sensor, np.random.default_rng(0))
    assert cast.scan().free_directions is None
    free = cast.scan(tell_free=True).free_directions
    through = np.abs(free[:, 1:] / free[:, :1]).max(1) < 0.09  # the far end: 2.6 m wide, 12 m ahead
    lost = np.abs(free[:, 1]) * 3.0 < 1.35  # meets a wall, if any, at 3 m and more
    assert np.count_nonzero(through & (free[:, 0] > 0)) > 250
    assert lost.all()
    assert len(free) + len(cast) < 16 * 1800
    np.testing.assert_allclose(np.linalg.norm(free, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("sensor", ["OS1-64", "VLP-16", "OS0-64"])
@pytest.mark.parametrize("closed", [False, True], ids=["two_open_ends", "one_open_end"])
def test_an_open_end_tells_slips_and_turns(sensor, closed):
    poses = [upright(x, 0.1 * x, 1.2, 0.1 * x) for x in (0.0, 3.0)]
    scans = scans_in(open_corridor(10.0, 8.0, closed), poses, sensor)
    T = se3.invert(poses[0]) @ poses[1]
    assert both_verdicts(scans, T, "lidar_indoor")[0] is Verdict.ACCEPTED
    wrong = [moved(T, (-2.5, 0, 0)), moved(T, (0, 0, 0), "z", 180.0)]
    verdicts = [both_verdicts(scans, pose, "lidar_indoor") for pose in wrong]
    assert [told for told, _ in verdicts] == [Verdict.REJECTED] * 2
    if not closed:
        assert verdicts[0][1] is not Verdict.REJECTED  # the rest of its evidence says nothing against it


@pytest.mark.parametrize("sensor", ["OS1-64", "VLP-16"])
def test_in_a_street_cars_that_left_fill_little_and_wrong_poses_much(sensor):
    world = build_scene("street", np.random.default_rng(3), SceneConfig(60.0, 0.5))
    caster, model = RayCaster(world), lidar_model(sensor)
    poses = [world.track.pose(way) @ upright(0, 0, world.sensor_height_m, turn) for way, turn in ((20.0, 0), (26.0, 1))]
    casts = [caster.cast(T, model, np.random.default_rng(k), 60.0 * k) for k, T in enumerate(poses)]
    config = preset("lidar_outdoor")
    target, source = (preprocess(cast.scan(tell_free=True), config.preprocess) for cast in casts)
    T, border = se3.invert(poses[0]) @ poses[1], config.decision.max_free_blocked_per_overlap

    def filled(pose: np.ndarray) -> float:
        seen = gather_evidence(source, target, pose, config.sight_view)
        ways = (seen.source_in_target, seen.target_in_source)
        return max(lines.free_blocked_ratio for lines in ways) / max(seen.oriented_overlap_ratio, 1e-3)

    assert 3.0 * filled(T) < border
    for wrong in (moved(T, (0, 0, 0), "x", 180.0), moved(T, (0, 0, 0), "z", 180.0), moved(T, (0, 3.0, 0))):
        assert filled(wrong) > 1.5 * border
