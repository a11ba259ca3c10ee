"""Labelled poses of simulated scans: streets where much moves, and rooms that look alike but are different ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lib.evidence import Judged, Row, measure_all
from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.registration import extract_features, prepare, register
from svc_ros.core.scan import Array, PreparedScan, Scan
from svc_ros.io.datasets import Candidate
from svc_ros.simulation import DriveConfig, build_scene, drive_scans, lidar_model
from svc_ros.simulation.meshes import upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.world import Scene, SceneConfig

TRAFFIC, ROOMS = "simulated traffic", "simulated rooms"
PRESETS = {TRAFFIC: "lidar_outdoor", ROOMS: "lidar_indoor"}
TRAFFIC_SENSORS, TRAFFIC_SEEDS = ("HDL-64E", "OS1-64", "VLP-16"), range(1, 7)
ROOM_SENSORS, ROOM_SEEDS = ("OS0-64", "OS1-64", "VLP-16"), range(17, 27)
_SHARE = 0.5  # of the parked cars, that are gone; of everything that may move, that does
_GONE_S, _LATER_S = 1.0, (2.0, 60.0)
_WAYS_M, _TURN_DEG = (24.0, 20.0), 11.0  # where source and target are taken; the source's yaw against the track
_LAST_BEFORE = 5  # the carrier is put into another building after this scan
_BOTH_SIDES = ((5, 6), (3, 8))  # target, source


@dataclass(frozen=True)
class Place:
    """One simulated world of one of the two sets, seen by one sensor; picklable, so that processes can share them."""

    dataset: str
    sensor: str
    seed: int

    @property
    def config(self) -> Config:
        """The preset that fits."""
        return preset(PRESETS[self.dataset])


def places() -> list[Place]:
    """All places of both sets."""
    streets = [Place(TRAFFIC, sensor, seed) for sensor in TRAFFIC_SENSORS for seed in TRAFFIC_SEEDS]
    return streets + [Place(ROOMS, sensor, seed) for sensor in ROOM_SENSORS for seed in ROOM_SEEDS]


def gather_simulated(job: tuple[Place, int]) -> list[Row]:
    """The rows of all poses at one place; `job` ends with the place's number."""
    place, number = job
    measured = [measure_all(judged, number + k) for k, judged in enumerate(_judged_at(place))]
    return [row for rows in measured for row in rows]


def _judged_at(place: Place) -> Iterator[Judged]:
    return _judge_rooms(place) if place.dataset == ROOMS else _judge_traffic(place)


# --- streets: the pose is the true one --------------------------------------------------------------------------------


def _judge_traffic(place: Place) -> Iterator[Judged]:
    parked = build_scene("street", np.random.default_rng(place.seed), SceneConfig(moving_share=0.0))
    yield _judge_later(place, without_cars(parked, place.seed), _LATER_S[-1], "half of the parked cars gone")
    moving = build_scene("street", np.random.default_rng(place.seed), SceneConfig(moving_share=_SHARE))
    for time_s in _LATER_S:
        yield _judge_later(place, moving, time_s, f"half of everything moves, {time_s:g} s later")


def without_cars(scene: Scene, seed: int) -> Scene:
    """The scene with half of its cars gone from one second on."""
    cars = [k for k, kind in enumerate(scene.kinds()) if kind == "car"]
    gone = set(np.random.default_rng([seed, 1]).permutation(cars)[: round(_SHARE * len(cars))].tolist())
    objects = [dataclasses.replace(o, leaves_at_s=_GONE_S) if k in gone else o for k, o in enumerate(scene.objects)]
    return dataclasses.replace(scene, objects=tuple(objects))


def _judge_later(place: Place, scene: Scene, time_s: float, what: str) -> Judged:
    """The true pose between a scan at time zero and a later one from a few metres ahead."""
    caster = RayCaster(scene)
    scans, poses = zip(*(
        _look_around(scene, caster, place, at)
        for at in ((_WAYS_M[0], _TURN_DEG, time_s), (_WAYS_M[1], 0.0, 0.0))
    ), strict=True)  # fmt: skip
    T = se3.invert(poses[1]) @ poses[0]
    source, target = (prepare(scan, place.config) for scan in scans)
    return _as_judged(place, what, (source, target), Candidate(T, "correct", "truth"))


def _look_around(
    scene: Scene, caster: RayCaster, place: Place, at: tuple[float, float, float]
) -> tuple[Scan, Array]:
    """The scan and T_world_sensor (4, 4) `at` a way [m], yaw against the track [deg] and time [s]."""
    way_m, turn_deg, time_s = at
    T = scene.track.pose(way_m) @ upright(0.0, 0.0, scene.sensor_height_m, np.radians(turn_deg))
    rng = np.random.default_rng([place.seed, int(way_m), int(time_s)])
    return caster.cast(T, lidar_model(place.sensor), rng, time_s).scan(), T


# --- rooms: no pose is right, and the best one found is judged --------------------------------------------------------


def _judge_rooms(place: Place) -> Iterator[Judged]:
    """The best pose that `register` finds between a scan in one building and a scan in another one; if it finds any."""
    drive = DriveConfig("indoor", place.sensor, 9, 0.5, 2.0, place.seed, teleport_after=_LAST_BEFORE)
    used = {k for pair in _BOTH_SIDES for k in pair}
    features = {
        k: extract_features(scan.cast.scan(), place.config)
        for k, scan in enumerate(drive_scans(drive)) if k in used
    }  # fmt: skip
    for before, after in _BOTH_SIDES:
        found = register(features[after], features[before], place.config).best_candidate
        if found is not None:
            scans = (features[after].prepared, features[before].prepared)
            yield _as_judged(place, f"scan {after} in scan {before}", scans, Candidate(found, "wrong", "register"))


def _as_judged(place: Place, what: str, scans: tuple[PreparedScan, PreparedScan], candidate: Candidate) -> Judged:
    name = f"{place.sensor}, seed {place.seed}: {what}"
    return Judged(place.dataset, name, scans, place.config, [candidate], candidate.T_target_source)
