"""Small simulated scans with a known pose, for tests of every layer. Made once a process, and the same in every one."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from svc_ros.core import se3
from svc_ros.core.scan import Array, Scan
from svc_ros.simulation.meshes import upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.scenes import build_scene
from svc_ros.simulation.sensors import lidar_model
from svc_ros.simulation.world import SceneConfig

Pair = tuple[Scan, Scan, Array]
_COLUMNS = 512  # half of a real turn: about 30k points


def street_pair(seed: int = 0) -> Pair:
    """(source, target, T_target_source) of a street, 4 m apart and turned by 20 deg; fits preset lidar_outdoor."""
    return _pair("street", "OS1-64", seed, (10.0, 14.0, 20.0))


def room_pair(seed: int = 0) -> Pair:
    """(source, target, T_target_source) of a building, 1 m apart and turned by 30 deg; fits preset lidar_indoor."""
    return _pair("indoor", "OS0-64", seed, (4.0, 5.0, 30.0))


def unrelated_pair(seed: int = 0) -> tuple[Scan, Scan]:
    """(source, target) of two different streets: no true alignment exists."""
    return street_pair(seed)[0], street_pair(seed + 1000)[1]


@lru_cache(maxsize=16)
def _pair(scene_name: str, sensor_name: str, seed: int, placement: tuple[float, float, float]) -> Pair:
    """Scans at two ways [m] along the scene's track, the source turned by an angle [deg]; nothing moves."""
    target_m, source_m, turn_deg = placement
    scene = build_scene(scene_name, np.random.default_rng(seed), SceneConfig(length_m=24.0, moving_share=0.0))
    sensor, caster = replace(lidar_model(sensor_name), columns=_COLUMNS), RayCaster(scene)
    up = upright(0.0, 0.0, scene.sensor_height_m)
    T_world_target = scene.track.pose(target_m) @ up
    T_world_source = scene.track.pose(source_m) @ up @ upright(0.0, 0.0, 0.0, np.radians(turn_deg))
    target = caster.cast(T_world_target, sensor, np.random.default_rng([seed, 0])).scan(1_000_000_000)
    source = caster.cast(T_world_source, sensor, np.random.default_rng([seed, 1])).scan(2_000_000_000)
    T_target_source = se3.invert(T_world_target) @ T_world_source
    T_target_source.flags.writeable = False
    return source, target, T_target_source
