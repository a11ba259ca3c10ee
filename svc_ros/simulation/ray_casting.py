"""What a LiDAR measures in a simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core import se3
from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.scan import Array, IndexArray, Scan
from svc_ros.simulation.meshes import join
from svc_ros.simulation.sensors import LidarModel
from svc_ros.simulation.world import Scene, SceneObject

_NO_TRIANGLE = np.iinfo(np.uint32).max
# Share of the light that a surface sends back, by kind; the rest of the kinds are plain masonry.
_REFLECTIVITY = {"ground": 0.25, "floor": 0.3, "car": 0.4, "tree": 0.35, "pole": 0.6, "person": 0.4}
_MASONRY = 0.5
_WEAKEST_SIGNAL = 0.12  # of a white surface met head on at the sensor's range
_SIGNAL_SPREAD = 0.25  # of the logarithm, from return to return


@dataclass(frozen=True, eq=False)
class CastScan:
    """One simulated turn of a sensor, all taken at one instant.

    points: (N, 3) float32 [m] in the sensor's frame; intensity: (N,) float32 in [0, 1]; beam_idx: (N,) row of the
    beam table; object_idx: (N,) index into `Scene.objects` of what was hit; free_directions: (F, 3) float32 unit, the
    firings without a return: nothing in range, or, as the sensor cannot tell, a return that was lost or too weak.
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    beam_idx: IndexArray
    object_idx: IndexArray
    free_directions: NDArray[np.float32]

    def scan(self, stamp_ns: int = 0, frame_id: str = "lidar", *, tell_free: bool = False) -> Scan:
        """The points as a Scan whose sensor stands at the origin; tell_free: with the firings that met nothing."""
        free = self.free_directions.astype(np.float64) if tell_free else None
        return Scan(self.points.astype(np.float64), stamp_ns, frame_id, free_directions=free)

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class _Hits:
    """Where rays end: distance (N,) [m], inf for none; cosine (N,) of the incidence; object_idx (N,), -1 for none."""

    distance: Array
    cosine: Array
    object_idx: IndexArray


class RayCaster:
    """A scene made ready for many scans: what stands still is indexed once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        things = list(enumerate(scene.objects))
        self._static = _Tracer([(i, thing) for i, thing in things if thing.is_static], 0.0)
        self._moving = [(i, thing) for i, thing in things if not thing.is_static]
        self._reflectivity = np.array([_REFLECTIVITY.get(kind, _MASONRY) for kind in scene.kinds()])

    def cast(
        self, T_world_sensor: ArrayLike, sensor: LidarModel, rng: np.random.Generator, time_s: float = 0.0
    ) -> CastScan:
        """Scan from a pose (4, 4) at a time [s]: noise along the ray, lost returns, none beyond the sensor's range.

        A return is also lost where too little light comes back: dark, far or met at a grazing angle.
        """
        pose = se3.check_pose(T_world_sensor, "T_world_sensor")
        rays = sensor.directions()
        hits = self._trace(pose, rays, time_s)
        signal = self._signal(hits, sensor)
        keep = signal * np.exp(rng.normal(scale=_SIGNAL_SPREAD, size=len(rays))) > _WEAKEST_SIGNAL
        keep &= rng.random(len(rays)) >= sensor.dropout_ratio
        distance = hits.distance + rng.normal(scale=sensor.range_noise_m, size=len(rays))
        keep &= (distance >= sensor.min_range_m) & (distance <= sensor.max_range_m)
        points = rays[keep] * distance[keep, None]
        intensity = np.clip(self._reflectivity[hits.object_idx[keep]] * hits.cosine[keep], 0.0, 1.0)
        beams = np.nonzero(keep)[0] % sensor.num_beams
        free = rays[~keep & (distance >= sensor.min_range_m)].astype(np.float32)
        return CastScan(points.astype(np.float32), intensity.astype(np.float32), beams, hits.object_idx[keep], free)

    def _trace(self, pose: Array, rays: Array, time_s: float) -> _Hits:
        world_rays = se3.rotate(pose, rays)
        still = self._static.trace(pose[:3, 3], world_rays)
        moving = _Tracer(self._moving, time_s).trace(pose[:3, 3], world_rays)
        nearer = moving.distance < still.distance
        return _Hits(
            np.where(nearer, moving.distance, still.distance),
            np.where(nearer, moving.cosine, still.cosine),
            np.where(nearer, moving.object_idx, still.object_idx),
        )

    def _signal(self, hits: _Hits, sensor: LidarModel) -> Array:
        """Light that comes back, 1 for a white surface met head on at the sensor's range (falls with its square)."""
        reach = np.divide(sensor.max_range_m, hits.distance, out=np.zeros_like(hits.distance), where=hits.distance > 0)
        return np.asarray(self._reflectivity[hits.object_idx] * hits.cosine * reach**2)


class _Tracer:
    """Ray casting against the meshes of some objects at one time."""

    def __init__(self, things: list[tuple[int, SceneObject]], time_s: float) -> None:
        meshes = [(i, thing.mesh_at(time_s)) for i, thing in things]
        present = [(i, mesh) for i, mesh in meshes if mesh is not None and len(mesh.triangles)]
        owners = [np.full(len(mesh.triangles), i, np.int64) for i, mesh in present]
        self._objects = np.concatenate([np.zeros(0, np.int64), *owners])
        self._scene = None
        if present:
            mesh = join(mesh for _, mesh in present)
            self._scene = _open3d().t.geometry.RaycastingScene()
            self._scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))

    def trace(self, origin: Array, rays: Array) -> _Hits:
        """Nearest hits of rays (N, 3), unit, from `origin` (3,) in the world."""
        if self._scene is None:
            nothing = np.full(len(rays), -1, np.int64)
            return _Hits(np.full(len(rays), np.inf), np.zeros(len(rays)), nothing)
        six = np.concatenate([np.broadcast_to(origin, rays.shape), rays], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(_open3d().core.Tensor(six))
        triangle = answer["primitive_ids"].numpy()
        hit = triangle != _NO_TRIANGLE
        cosine = np.abs(np.einsum("ni,ni->n", answer["primitive_normals"].numpy(), rays))
        objects = np.full(len(rays), -1, np.int64)
        objects[hit] = self._objects[triangle[hit]]
        return _Hits(answer["t_hit"].numpy().astype(np.float64), np.where(hit, cosine, 0.0), objects)


def cast_scan(
    scene: Scene, T_world_sensor: ArrayLike, sensor: LidarModel, rng: np.random.Generator, time_s: float = 0.0
) -> CastScan:
    """One scan of a scene (see `RayCaster.cast`); for several scans keep a RayCaster, which is several times faster."""
    return RayCaster(scene).cast(T_world_sensor, sensor, rng, time_s)


def _open3d() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise MissingDependencyError("ray casting needs Open3D: pip install open3d-cpu (elsewhere: open3d)") from error
    return open3d
