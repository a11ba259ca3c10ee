"""Simulated scans at any place of any world, made once a process; described once a preset."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.registration import extract_features
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features, Scan
from svc_ros.simulation.meshes import upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.scenes import build_scene
from svc_ros.simulation.sensors import lidar_model
from svc_ros.simulation.world import Scene, SceneConfig

SUCCESS = (5.0, 0.6)  # deg, m: a pose within both is right
_GONE_S = 1.0  # when the cars that drive off are gone


@dataclass(frozen=True)
class Place:
    """Where and when a simulated scan is taken; `turn_deg` is the sensor's yaw against the track.

    gone_share: of the parked cars, gone from one second on; moving_share: see SceneConfig.
    """

    scene: str
    sensor: str
    seed: int
    way_m: float
    turn_deg: float = 0.0
    time_s: float = 0.0
    gone_share: float = 0.0
    moving_share: float = 0.0


@dataclass(frozen=True, eq=False)
class SimulatedPair:
    """Two described scans, the true pose, and the config that fits."""

    source: Features
    target: Features
    T: Array
    config: Config


@lru_cache(maxsize=32)
def _world(scene: str, seed: int, moving_share: float, gone_share: float) -> tuple[Scene, RayCaster]:
    world = build_scene(scene, np.random.default_rng(seed), SceneConfig(60.0, moving_share))
    cars = np.random.default_rng([seed, 7]).permutation([i for i, kind in enumerate(world.kinds()) if kind == "car"])
    gone = set(cars[: round(gone_share * len(cars))].tolist())
    objects = (replace(o, leaves_at_s=_GONE_S) if i in gone else o for i, o in enumerate(world.objects))
    world = replace(world, objects=tuple(objects))
    return world, RayCaster(world)


@lru_cache(maxsize=256)
def scan_at(place: Place) -> tuple[Scan, Array]:
    """The scan and T_world_sensor."""
    world, caster = _world(place.scene, place.seed, place.moving_share, place.gone_share)
    T = world.track.pose(place.way_m) @ upright(0.0, 0.0, world.sensor_height_m, np.radians(place.turn_deg))
    rng = np.random.default_rng([place.seed, round(10 * place.way_m), round(10 * place.time_s)])
    return caster.cast(T, lidar_model(place.sensor), rng, place.time_s).scan(), T


@lru_cache(maxsize=256)
def features_at(place: Place, preset_name: str) -> Features:
    """The described scan."""
    return extract_features(scan_at(place)[0], preset(preset_name))


def pair_at(source: Place, target: Place, preset_name: str) -> SimulatedPair:
    """Two scans of one world."""
    T = se3.invert(scan_at(target)[1]) @ scan_at(source)[1]
    return SimulatedPair(features_at(source, preset_name), features_at(target, preset_name), T, preset(preset_name))


def is_right(result: RegistrationResult, T: Array) -> bool:
    """True if the best candidate lies within the success limits."""
    if result.best_candidate is None:
        return False
    angle, distance = se3.pose_error(result.best_candidate, T)
    return angle <= SUCCESS[0] and distance <= SUCCESS[1]


def falsehood(result: RegistrationResult, T: Array | None) -> str:
    """What is wrong with an acceptance, in one line; empty where nothing was accepted or it is right."""
    if not result.accepted or (T is not None and is_right(result, T)):
        return ""
    error = "no pose is right" if T is None else "off by {:.1f} deg, {:.2f} m".format(
        *se3.pose_error(result.best_candidate, T)
    )  # fmt: skip
    numbers = {name: round(value, 4) for name, value in result.evidence.numbers().items() if "ratio" in name}
    return f"accepted with probability {result.probability:.2f}, {error}: {numbers}"


def moved(T: Array, shift_m: tuple[float, float, float], axis: str = "z", turn_deg: float = 0.0) -> Array:
    """The pose with the source turned about its own axis, then shifted in the target's frame."""
    turn = Rotation.from_euler(axis, turn_deg, degrees=True).as_matrix()
    return se3.make_pose(T[:3, :3] @ turn, T[:3, 3] + np.asarray(shift_m))


def wrong_poses(T: Array, num: int, seed: int) -> list[Array]:
    """Shifted by 1.5 to 5 m, turned by 15 to 180 deg, or both, in turns; mostly in the plane."""
    rng, poses = np.random.default_rng(seed), []
    for k in range(num):
        direction = rng.normal(size=3) * (1.0, 1.0, 1.0 if k % 3 == 0 else 0.15)
        shift = direction / np.linalg.norm(direction) * rng.uniform(1.5, 5.0)
        axis = np.array([0.0, 0.0, 1.0]) if rng.random() < 0.7 else rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(rng.uniform(15, 180)) * axis / np.linalg.norm(axis)).as_matrix()
        if k % 3 == 0:
            turn = np.eye(3)
        poses.append(se3.make_pose(turn @ T[:3, :3], T[:3, 3] + (k % 3 != 1) * shift))
    return poses
