"""What a LiDAR measures in a simulated world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core import se3
from svc_ros.core.scan import Array, IndexArray, Scan
from svc_ros.simulation.carrier_motion import SensorMotion
from svc_ros.simulation.effects import mixed_distances
from svc_ros.simulation.glass import through_panes
from svc_ros.simulation.sensor_model import SensorModel
from svc_ros.simulation.tracing import Hits, Tracer, World
from svc_ros.simulation.world import GLASS, Scene, side_generator

# Share of the light that a surface sends back, by kind; the rest of the kinds are plain masonry.
_REFLECTIVITY = {"ground": 0.25, "floor": 0.3, "car": 0.4, "tree": 0.35, "pole": 0.6, "person": 0.4}
_MASONRY = 0.5
_WEAKEST_SIGNAL = 0.12  # of a white surface met head on at the sensor's range
_SIGNAL_SPREAD = 0.25  # of the logarithm, from return to return


@dataclass(frozen=True, eq=False)
class CastScan:
    """One simulated scan, taken at one instant or, with a motion, firing by firing on the way.

    points: (N, 3) float32 [m] in the sensor's frame; intensity: (N,) float32 in [0, 1]; beam_idx: (N,) row of the
    beam table; object_idx: (N,) index into `Scene.objects` of what was hit; free_directions: (F, 3) float32 unit, the
    firings without a return: nothing in range, or, as the sensor cannot tell, a return that was lost or too weak;
    times_s: (N,) float32 time of every point's firing after the scan's stamp [s], None where all are taken at once.
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    beam_idx: IndexArray
    object_idx: IndexArray
    free_directions: NDArray[np.float32]
    times_s: NDArray[np.float32] | None = None

    def scan(self, stamp_ns: int = 0, frame_id: str = "lidar", *, tell_free: bool = False) -> Scan:
        """The points as a Scan whose sensor stands at the origin; tell_free: with the firings that met nothing.

        Firing times are not told: `times_s` holds them.
        """
        free = self.free_directions.astype(np.float64) if tell_free else None
        return Scan(self.points.astype(np.float64), stamp_ns, frame_id, free_directions=free)

    def __len__(self) -> int:
        return len(self.points)


class RayCaster:
    """A scene made ready for many scans: what stands still is indexed once. Panes (kind `glass`) let light through."""

    def __init__(self, scene: Scene) -> None:
        things = list(enumerate(scene.objects))
        solid = [(i, thing) for i, thing in things if thing.kind != GLASS]
        self._static = Tracer([(i, thing) for i, thing in solid if thing.is_static], 0.0)
        self._moving = [(i, thing) for i, thing in solid if not thing.is_static]
        self._panes = Tracer([(i, thing) for i, thing in things if thing.kind == GLASS], 0.0)
        self._reflectivity = np.array([_REFLECTIVITY.get(kind, _MASONRY) for kind in scene.kinds()])

    def cast(
        self, T_world_sensor: ArrayLike, sensor: SensorModel, rng: np.random.Generator, time_s: float = 0.0,
        motion: SensorMotion | None = None,
    ) -> CastScan:  # fmt: skip
        """Scan from a pose (4, 4) at a time [s]: noise along the ray, lost returns, none beyond the sensor's range.

        A return is also lost where too little light comes back: dark, far or met at a grazing angle. With a motion,
        the pose is that of the stamp, every ray is cast from where the sensor is when it fires, and the points are told
        as if it had stood still, smeared as a real moving sensor's are; other things stay where they are at `time_s`.
        """
        pose = se3.check_pose(T_world_sensor, "T_world_sensor")
        rays = sensor.directions()
        offsets = None if motion is None else motion.offsets_s(sensor.firing_times_s())
        hits = self._measure(_paths(pose, rays, motion, offsets), sensor, rng, time_s)
        signal = self._signal(hits, sensor)
        keep = signal * np.exp(rng.normal(scale=_SIGNAL_SPREAD, size=len(rays))) > _WEAKEST_SIGNAL
        keep &= rng.random(len(rays)) >= sensor.dropout_ratio
        # What is measured: the range, or a camera's depth.
        scale = rays[:, 2] if sensor.is_optical else np.ones(len(rays))
        true = hits.distance * scale
        sigma = sensor.effects.sigma_m(sensor.range_noise_m, true, sensor.max_range_m)
        depth = sensor.effects.stepped(true + rng.normal(scale=sigma, size=len(rays)))
        keep &= (depth >= sensor.min_range_m) & (depth <= sensor.max_range_m)
        points = rays[keep] * (depth / scale)[keep, None]
        intensity = np.clip(self._reflectivity[hits.object_idx[keep]] * hits.cosine[keep], 0.0, 1.0)
        beams = np.nonzero(keep)[0] % sensor.num_beams
        free = rays[~keep & (depth >= sensor.min_range_m)].astype(np.float32)
        times = None if offsets is None else offsets[keep].astype(np.float32)
        return CastScan(
            points.astype(np.float32), intensity.astype(np.float32), beams, hits.object_idx[keep], free, times
        )

    def _measure(
        self, paths: tuple[Array, Array], sensor: SensorModel, rng: np.random.Generator, time_s: float
    ) -> Hits:
        """What the beams from places (3,) or (N, 3) along (N, 3) in the world meet, through panes and across edges."""
        world = World(self._static, Tracer(self._moving, time_s))
        origin, rays = paths
        hits, plain = world.trace(origin, rays), np.ones(len(rays), np.bool_)
        if self._panes.is_empty and not sensor.effects.mixes:
            return hits
        own = side_generator(rng)
        if not self._panes.is_empty:
            hits, by_pane = through_panes(self._panes, world, paths, hits, own)
            plain = ~by_pane
        if sensor.effects.mixes:
            mixed = mixed_distances(
                sensor.effects, rays, hits.distance, lambda rim: world.trace(origin, rim).distance, own
            )
            hits = Hits(np.where(plain, mixed, hits.distance), hits.cosine, hits.object_idx)
        return hits

    def _signal(self, hits: Hits, sensor: SensorModel) -> Array:
        """Light that comes back, 1 for a white surface met head on at the sensor's range (falls with its square)."""
        reach = np.divide(sensor.max_range_m, hits.distance, out=np.zeros_like(hits.distance), where=hits.distance > 0)
        return np.asarray(self._reflectivity[hits.object_idx] * hits.cosine * reach**2)


def _paths(pose: Array, rays: Array, motion: SensorMotion | None, offsets: Array | None) -> tuple[Array, Array]:
    """Where the rays (N, 3) start, (3,) or (N, 3), and their directions (N, 3), in the world."""
    if motion is None or offsets is None:
        return pose[:3, 3], se3.rotate(pose, rays)
    R, places = motion.poses(offsets)
    return se3.apply(pose, places), se3.rotate(pose, np.einsum("nij,nj->ni", R, rays))


def cast_scan(
    scene: Scene, T_world_sensor: ArrayLike, sensor: SensorModel, rng: np.random.Generator, time_s: float = 0.0
) -> CastScan:
    """One scan of a scene (see `RayCaster.cast`); for several scans keep a RayCaster, which is several times faster."""
    return RayCaster(scene).cast(T_world_sensor, sensor, rng, time_s)
