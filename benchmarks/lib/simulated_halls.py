"""Labelled poses in simulated halls of equal sides: turned by half a circle about its middle all walls agree.

Only what stands in a hall tells the two poses apart, as in offices, staircases and storage halls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lib.evidence import Judged, Row, measure_all
from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Array
from svc_ros.io.datasets import Candidate
from svc_ros.simulation import lidar_model
from svc_ros.simulation.meshes import box, upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.world import Scene, SceneObject, Track

HALLS = "simulated halls"
PRESETS = {HALLS: "lidar_indoor"}
SENSORS, SEEDS = ("OS0-64", "OS1-64", "VLP-16"), range(111, 119)
_SIDES_M, _HEIGHT_M = (6.0, 18.0), (2.6, 5.0)  # of a hall, from and to
_THINGS, _SIZE_M = (4, 10), (0.4, 2.5)  # boxes in it, and their edges
_SENSOR_HEIGHT_M, _WALL_M = 1.2, 0.2
_CLEAR_M = 1.0  # no thing stands nearer to a sensor


@dataclass(frozen=True)
class Place:
    """One hall seen by one sensor; picklable, so that processes can share them."""

    sensor: str
    seed: int

    @property
    def config(self) -> Config:
        """The preset that fits."""
        return preset(PRESETS[HALLS])


def places() -> list[Place]:
    """All halls by all sensors."""
    return [Place(sensor, seed) for sensor in SENSORS for seed in SEEDS]


def gather_simulated(job: tuple[Place, int]) -> list[Row]:
    """The rows of the poses in one hall; `job` ends with its number."""
    place, number = job
    return measure_all(judge(place), number)


def judge(place: Place) -> Judged:
    """The true pose between two scans in the hall, and the one turned by half a circle about the hall's middle."""
    rng = np.random.default_rng([place.seed, 101])
    sides = rng.uniform(*_SIDES_M, 2)
    stands = [_stand(rng, sides) for _ in range(2)]
    caster = RayCaster(_hall(rng, sides, stands))
    model = lidar_model(place.sensor)
    source, target = (
        prepare(caster.cast(T, model, np.random.default_rng([place.seed, k])).scan(), place.config)
        for k, T in enumerate(stands)
    )
    to_target = se3.invert(stands[1])
    T, half_turn = to_target @ stands[0], to_target @ upright(0.0, 0.0, 0.0, np.pi) @ stands[0]
    poses = [Candidate(T, "correct", "truth"), Candidate(half_turn, "wrong", "half turn")]
    return Judged(HALLS, f"{place.sensor}, hall {place.seed}", (source, target), place.config, poses, T)


def _stand(rng: np.random.Generator, sides: Array) -> Array:
    """Pose (4, 4) of a sensor somewhere in the inner half of a hall with these sides [m]."""
    x, y = rng.uniform(-0.25, 0.25, 2) * sides
    return upright(float(x), float(y), _SENSOR_HEIGHT_M, float(rng.uniform(-np.pi, np.pi)))


def _hall(rng: np.random.Generator, sides: Array, stands: list[Array]) -> Scene:
    """Floor, ceiling and four walls around 0, 0, and boxes that do not stand on the sensors."""
    (a, b), height = sides, rng.uniform(*_HEIGHT_M)
    shell = [((a, b, _WALL_M), (0.0, 0.0, z)) for z in (-_WALL_M, height)]
    shell += [((_WALL_M, b, height), (side * 0.5 * (a + _WALL_M), 0.0, 0.0)) for side in (-1, 1)]
    shell += [((a, _WALL_M, height), (0.0, side * 0.5 * (b + _WALL_M), 0.0)) for side in (-1, 1)]
    things, num_things = [], rng.integers(*_THINGS)
    while len(things) < num_things:
        size = np.minimum(rng.uniform(*_SIZE_M, 3), (*(0.3 * sides), height))
        at = rng.uniform(-0.5, 0.5, 2) * (sides - size[:2])
        if all(np.hypot(*(at - T[:2, 3])) > _CLEAR_M + 0.5 * np.hypot(*size[:2]) for T in stands):
            things.append((tuple(size), (*at, 0.0)))
    way = np.column_stack([np.linspace(0.0, 1.0, 11), np.zeros(11)])
    track = Track.on_ground(way, lambda x, y: np.zeros_like(x))
    objects = [SceneObject("wall", box(*slab)) for slab in shell] + [SceneObject("clutter", box(*t)) for t in things]
    return Scene("hall", tuple(objects), track, _SENSOR_HEIGHT_M)
