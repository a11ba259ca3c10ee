"""A drive through a simulated world, written as a ROS 2 bag with its reference trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import unknown_name
from svc_ros.core.errors import ConfigError, InputError
from svc_ros.core.scan import Array
from svc_ros.io.bags import CloudBagWriter
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.simulation.meshes import upright
from svc_ros.simulation.ray_casting import CastScan, RayCaster
from svc_ros.simulation.scenes import SCENES, build_scene
from svc_ros.simulation.sensor_model import T_BODY_OPTICAL, SensorModel
from svc_ros.simulation.sensors import sensor_model
from svc_ros.simulation.world import Scene, SceneConfig

MAP_FRAME, BASE_FRAME, LIDAR_FRAME = "map", "base_link", "lidar"
POINTS_TOPIC = "/points"
_SPACING_M = {"street": 3.0}  # between two scans; a person who carries the sensor is slower
_WALK_SPACING_M = 1.0
_MOUNT_YAW_RAD = 0.03  # the sensor sits ahead of the base's middle and is not quite straight, as on real robots
_MOUNT_AHEAD_M = 0.4
_ELSEWHERE = upright(800.0, 500.0, 0.0, 1.0)  # where the map holds the place behind a teleport


@dataclass(frozen=True)
class DriveConfig:
    """What is driven: everything in the bag follows from these values.

    scene, sensor: names (see `SCENES`, `SENSORS`; a depth camera's points are told in its optical frame, z ahead);
    spacing_m: way between two scans [m], None for what suits the scene; rate_hz: scans a second;
    seed: of the world and of the noise; start_ns: stamp of the first scan;
    moving_share: share of cars or people that move or leave, in [0, 1]; teleport_after: index of the last scan before
    the carrier is put into a different world, so that this scan and the next have no true alignment; there_and_back:
    from half-way on the carrier backs up along the way that it came, so that places are seen twice.
    """

    scene: str = "street"
    sensor: str = "OS1-64"
    num_scans: int = 20
    spacing_m: float | None = None
    rate_hz: float = 2.0
    seed: int = 0
    start_ns: int = 1_700_000_000_000_000_000
    moving_share: float = 0.15
    teleport_after: int | None = None
    there_and_back: bool = False

    def __post_init__(self) -> None:
        if self.scene not in SCENES:
            raise ConfigError(unknown_name("scene", self.scene, list(SCENES)))
        sensor_model(self.sensor)
        if self.num_scans < 1 or not self.rate_hz > 0.0 or self.step_m < 0.0 or self.seed < 0 or self.start_ns < 0:
            raise ConfigError("drive: expected num_scans >= 1, rate_hz > 0, spacing_m, seed and start_ns >= 0, "
                              f"found {self}")  # fmt: skip
        if not 0.0 <= self.moving_share <= 1.0:
            raise ConfigError(f"drive: expected moving_share from 0 to 1, found {self.moving_share}")
        if self.teleport_after is not None and not 0 <= self.teleport_after < self.num_scans - 1:
            raise ConfigError(f"drive: expected teleport_after from 0 to {self.num_scans - 2} (there are "
                              f"{self.num_scans} scans), found {self.teleport_after}")  # fmt: skip

    @property
    def step_m(self) -> float:
        """Way between two scans [m]."""
        return _SPACING_M.get(self.scene, _WALK_SPACING_M) if self.spacing_m is None else self.spacing_m

    def way_m(self, k: int) -> float:
        """Where along the track scan k is taken [m]; on the way back half-way between the scans of the way there."""
        last = self.num_scans - 1
        return self.step_m * (last - k + 0.5 if self.there_and_back and 2 * k > last else k)


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """One scan of a drive: stamp [ns], what the sensor saw, poses (4, 4) of base and sensor in the map."""

    stamp_ns: int
    cast: CastScan
    T_map_base: Array
    T_map_lidar: Array


@dataclass(frozen=True, eq=False)
class DriveSummary:
    """What was written. bag: folder of the ROS 2 bag; reference: TUM file, poses of the sensor in the map;
    num_points: of all scans; length_m: way driven; duration_s: from the first to the last stamp."""

    bag: Path
    reference: Path
    num_scans: int
    num_points: int
    length_m: float
    duration_s: float


def simulate_drive(
    out_dir: str | Path, config: DriveConfig | None = None, on_progress: Callable[[int, int], None] | None = None
) -> DriveSummary:
    """Write `out_dir/bag` (a ROS 2 bag folder) and `out_dir/reference_tum.txt`.

    Topics: /points in the frame `lidar`; /tf map -> base_link at every scan's stamp; /tf_static base_link -> lidar.
    `on_progress(done, total)` is called after every scan. An existing bag is refused with InputError.
    """
    config, out = config or DriveConfig(), Path(out_dir)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made a folder: {error.strerror}") from None
    stamps: list[int] = []
    poses: list[Array] = []
    num_points = 0
    with CloudBagWriter(out / "bag") as bag:
        for scan in drive_scans(config):
            cast = scan.cast
            if not stamps:
                mount = se3.invert(scan.T_map_base) @ scan.T_map_lidar
                bag.write_transform(scan.stamp_ns, BASE_FRAME, LIDAR_FRAME, mount, static=True)
            bag.write_transform(scan.stamp_ns, MAP_FRAME, BASE_FRAME, scan.T_map_base)
            cloud = np.column_stack([cast.points, cast.intensity])
            bag.write_points(scan.stamp_ns, LIDAR_FRAME, cloud, POINTS_TOPIC)
            stamps.append(scan.stamp_ns)
            poses.append(scan.T_map_lidar)
            num_points += len(cast)
            if on_progress is not None:
                on_progress(len(stamps), config.num_scans)
    reference = out / "reference_tum.txt"
    write_tum(reference, Trajectory(np.array(stamps, np.int64), np.stack(poses)))
    ways = np.abs(np.diff([config.way_m(k) for k in range(config.num_scans)]))
    length = float(ways.sum() - (0.0 if config.teleport_after is None else ways[config.teleport_after]))
    return DriveSummary(out / "bag", reference, len(stamps), num_points, length, (stamps[-1] - stamps[0]) * 1e-9)


def drive_scans(config: DriveConfig) -> Iterator[SimulatedScan]:
    """Simulate the scans of a drive one after the other, without writing anything."""
    sensor, worlds = sensor_model(config.sensor), _worlds(config)
    caster, place = RayCaster(worlds[0]), 0
    for k in range(config.num_scans):
        if config.teleport_after is not None and k == config.teleport_after + 1:
            place = 1
            caster = RayCaster(worlds[1])
        world = worlds[place]
        T_world_base, time_s = world.track.pose(config.way_m(k)), k / config.rate_hz
        T_world_lidar = T_world_base @ _mount(world, sensor)
        rng = np.random.default_rng([config.seed, 1, k])
        cast = caster.cast(T_world_lidar, sensor, rng, time_s)
        T_map_world = _ELSEWHERE if place else np.eye(4)
        stamp = config.start_ns + round(k * 1e9 / config.rate_hz)
        yield SimulatedScan(stamp, cast, T_map_world @ T_world_base, T_map_world @ T_world_lidar)


def _worlds(config: DriveConfig) -> list[Scene]:
    size = SceneConfig(max(config.step_m * config.num_scans, 1.0), config.moving_share, config.step_m * config.rate_hz)
    seeds = [0] if config.teleport_after is None else [0, 2]
    return [build_scene(config.scene, np.random.default_rng([config.seed, part]), size) for part in seeds]


def _mount(world: Scene, sensor: SensorModel) -> Array:
    """T_base_lidar (4, 4)."""
    mount = upright(_MOUNT_AHEAD_M, 0.0, world.sensor_height_m, _MOUNT_YAW_RAD)
    return mount @ T_BODY_OPTICAL if sensor.is_optical else mount
