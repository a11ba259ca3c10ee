"""Smear of a moving sensor, noise that grows, beams with a width."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_simulation import box_room, quiet, straight_track

from svc_ros.core import se3
from svc_ros.core.errors import ConfigError
from svc_ros.simulation.carrier_motion import SensorMotion
from svc_ros.simulation.effects import Effects
from svc_ros.simulation.meshes import box, upright
from svc_ros.simulation.ray_casting import CastScan, RayCaster, cast_scan
from svc_ros.simulation.sensors import LidarModel, lidar_model
from svc_ros.simulation.world import Scene, SceneObject

POST_X, WALL_X = 5.0, 12.0


def smeared(motion: SensorMotion | None, sensor: LidarModel | None = None) -> CastScan:
    sensor = sensor or quiet(lidar_model("OS0-64"))
    return RayCaster(box_room()).cast(upright(3.0, -2.0, 1.0, 0.7), sensor, np.random.default_rng(0), 0.0, motion)


def to_walls(points: np.ndarray) -> np.ndarray:
    return np.abs(np.array([20.0, 10.0, 5.0]) - np.abs(se3.apply(upright(3.0, -2.0, 1.0, 0.7), points))).min(1)


def post_before_wall() -> Scene:
    """A narrow post before a wall, both across the x axis."""
    things = [SceneObject("post", box((0.2, 0.6, 20.0), (POST_X + 0.1, 0.0, -10.0)))]
    things.append(SceneObject("wall", box((0.2, 200.0, 200.0), (WALL_X + 0.1, 0.0, -100.0))))
    return Scene("post", tuple(things), straight_track(), 0.0)


# Smear


@pytest.mark.parametrize("stamp_share", [0.0, 0.5, 1.0])
def test_the_smear_is_the_motion_and_is_undone_by_it(stamp_share: float) -> None:
    motion = SensorMotion((9.0, -1.0, 0.2), (3.0, -5.0, 40.0), stamp_share)
    cast = smeared(motion)
    assert cast.times_s is not None
    assert np.ptp(cast.times_s) == pytest.approx(0.1, abs=1e-3)
    assert cast.times_s.min() == pytest.approx(-0.1 * stamp_share, abs=1e-3)
    R, places = motion.poses(cast.times_s.astype(np.float64))
    undone = np.einsum("nij,nj->ni", R, cast.points) + places
    assert to_walls(cast.points).max() > 0.3
    assert to_walls(undone).max() < 2e-3


def test_a_car_that_drives_ahead_shortens_what_is_ahead_by_its_way() -> None:
    """Halfway through the turn the beam looks back: the wall behind is farther by half of the way."""
    still, ahead = smeared(None), smeared(SensorMotion((10.0, 0.0, 0.0)))
    assert still.times_s is None
    assert np.array_equal(still.beam_idx, ahead.beam_idx)
    elsewhere = cast_scan(
        box_room(), upright(3.0, -2.0, 1.0, 0.7) @ upright(0.5, 0.0), quiet(lidar_model("OS0-64")),
        np.random.default_rng(0),
    )  # fmt: skip
    middle = slice(512 * 64, 513 * 64)
    assert ahead.points[middle] == pytest.approx(elsewhere.points[middle], abs=1e-3)


def test_poses_of_a_motion_follow_from_small_steps() -> None:
    motion = SensorMotion((8.0, 1.0, -0.5), (10.0, -20.0, 45.0))
    T, steps, dt = np.eye(4), 20_000, 0.5 / 20_000
    turn = Rotation.from_rotvec(np.radians(motion.turn_rate_dps) * dt).as_matrix()
    step = se3.make_pose(turn, np.array(motion.velocity_mps) * dt)
    for _ in range(steps):
        T = T @ step
    R, places = motion.poses(np.array([0.0, 0.5]))
    assert R[1] == pytest.approx(T[:3, :3], abs=1e-6)
    assert places[1] == pytest.approx(T[:3, 3], abs=1e-3)
    assert (R[0] == np.eye(3)).all()
    assert (places[0] == 0.0).all()


def test_a_motion_of_nothing_changes_nothing() -> None:
    assert smeared(SensorMotion()).points == pytest.approx(smeared(None).points, abs=1e-5)


# Noise


def test_noise_grows_with_range_as_told() -> None:
    effects = Effects(noise_per_m=2e-3, noise_per_m2=1e-3)
    sensor = replace(lidar_model("OS0-64"), range_noise_m=0.01, dropout_ratio=0.0, effects=effects)
    for distance in (3.0, 12.0):
        wall = SceneObject("wall", box((0.2, 200.0, 200.0), (distance + 0.1, 0.0, -100.0)))
        scene = Scene("wall", (wall,), straight_track(), 0.0)
        points = cast_scan(scene, np.eye(4), sensor, np.random.default_rng(0)).points
        near_axis = np.linalg.norm(points[:, 1:], axis=1) < 0.2 * distance
        expected = 0.01 + 2e-3 * distance + 1e-3 * distance**2
        assert near_axis.sum() > 300
        assert np.std(points[near_axis, 0]) == pytest.approx(expected, rel=0.15)


def test_depth_comes_in_steps_of_its_inverse() -> None:
    effects = Effects(inverse_depth_step=0.01)
    stepped = effects.stepped(np.array([1.0, 4.1, 60.0, 500.0, np.inf]))
    assert stepped[:2] == pytest.approx([1.0, 1.0 / 0.24])
    assert np.isinf(stepped[3:]).all()
    assert (Effects().stepped(stepped) == stepped).all()


# Footprint


def wide(mixed_ratio: float = 0.5, mixed_gap_m: float = 20.0) -> LidarModel:
    effects = Effects(footprint_mrad=5.0, mixed_ratio=mixed_ratio, mixed_gap_m=mixed_gap_m)
    return replace(quiet(lidar_model("OS0-64")), effects=effects)


def between(cast: CastScan) -> np.ndarray:
    x = cast.points[:, 0]
    return (x > POST_X + 0.01) & (x < WALL_X - 0.01) & (np.abs(cast.points[:, 1]) < 2.0)


def test_beams_across_an_edge_return_from_between_its_sides() -> None:
    cast = cast_scan(post_before_wall(), np.eye(4), wide(), np.random.default_rng(0))
    mixed = cast.points[between(cast)]
    assert len(mixed) > 20
    azimuth = np.abs(np.arctan2(mixed[:, 1], mixed[:, 0]))
    assert azimuth == pytest.approx(np.arctan2(0.3, POST_X), abs=0.006)  # nowhere but at the post's two edges
    assert mixed[:, 0].min() < POST_X + 2.0
    assert mixed[:, 0].max() > WALL_X - 2.0


@pytest.mark.parametrize("sensor", [quiet(lidar_model("OS0-64")), wide(mixed_ratio=0.0), wide(mixed_gap_m=3.0)])
def test_nothing_lies_between_where_beams_do_not_mix(sensor: LidarModel) -> None:
    assert not between(cast_scan(post_before_wall(), np.eye(4), sensor, np.random.default_rng(0))).any()


def test_a_slant_is_no_edge_and_other_numbers_stay() -> None:
    """A floor that runs away under the beams mixes nothing, and the noise of all other beams is what it was."""
    floor = SceneObject("floor", box((400.0, 400.0, 0.2), (0.0, 0.0, -2.2)))
    scene = Scene("floor", (floor,), straight_track(), 0.0)
    noisy = replace(wide(), range_noise_m=0.02, dropout_ratio=0.1)
    plain = replace(noisy, effects=Effects())
    first, second = (cast_scan(scene, np.eye(4), sensor, np.random.default_rng(3)) for sensor in (noisy, plain))
    assert np.array_equal(first.points, second.points)
    with_post, without = (
        cast_scan(post_before_wall(), np.eye(4), sensor, np.random.default_rng(3)) for sensor in (noisy, plain)
    )
    assert len(with_post) == len(without)
    changed = (with_post.points != without.points).any(axis=1)
    assert 0 < changed.sum() < 0.01 * len(changed)


def test_effects_follow_from_the_seed() -> None:
    first, again, other = (
        cast_scan(post_before_wall(), np.eye(4), wide(), np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert np.array_equal(first.points, again.points)
    assert not np.array_equal(first.points, other.points)


def test_impossible_effects_and_motions_are_refused() -> None:
    with pytest.raises(ConfigError, match="mixed_ratio"):
        Effects(mixed_ratio=1.5)
    with pytest.raises(ConfigError, match="sizes >= 0"):
        Effects(noise_per_m=-1.0)
    with pytest.raises(ConfigError, match="stamp_share"):
        SensorMotion(stamp_share=2.0)
