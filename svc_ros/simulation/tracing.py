"""Where rays meet the things of a simulated world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.scan import Array, IndexArray
from svc_ros.simulation.meshes import join
from svc_ros.simulation.world import SceneObject

_NO_TRIANGLE = np.iinfo(np.uint32).max


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays end: distance (N,) [m], inf for none; cosine (N,) of the incidence; object_idx (N,), -1 for none."""

    distance: Array
    cosine: Array
    object_idx: IndexArray

    def where(self, mask: NDArray[np.bool_], other: Hits) -> Hits:
        """These hits, where the mask (N,) holds, and the other ones elsewhere."""
        return Hits(
            np.where(mask, self.distance, other.distance),
            np.where(mask, self.cosine, other.cosine),
            np.where(mask, self.object_idx, other.object_idx),
        )


class Tracer:
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

    @property
    def is_empty(self) -> bool:
        """True if there is nothing to meet."""
        return self._scene is None

    def trace(self, origin: Array, rays: Array) -> Hits:
        """Nearest hits of rays (N, 3), unit, from `origin` (3,), or from (N, 3) places of their own, in the world."""
        return self.trace_normals(origin, rays)[0]

    def trace_normals(self, origin: Array, rays: Array) -> tuple[Hits, Array]:
        """The same, with the unit normals (N, 3) of what was met, zero for nothing."""
        if self._scene is None:
            nothing = np.full(len(rays), -1, np.int64)
            return Hits(np.full(len(rays), np.inf), np.zeros(len(rays)), nothing), np.zeros_like(rays)
        six = np.concatenate([np.broadcast_to(origin, rays.shape), rays], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(_open3d().core.Tensor(six))
        triangle = answer["primitive_ids"].numpy()
        hit = triangle != _NO_TRIANGLE
        normals = answer["primitive_normals"].numpy()
        cosine = np.abs(np.einsum("ni,ni->n", normals, rays))
        objects = np.full(len(rays), -1, np.int64)
        objects[hit] = self._objects[triangle[hit]]
        return Hits(answer["t_hit"].numpy().astype(np.float64), np.where(hit, cosine, 0.0), objects), normals


class World:
    """What stands still and what moves, traced as one at one time."""

    def __init__(self, still: Tracer, moving: Tracer) -> None:
        self._still, self._moving = still, moving

    def trace(self, origin: Array, rays: Array) -> Hits:
        """Nearest hits of rays (N, 3), unit, from (3,) or (N, 3) places."""
        still, moving = self._still.trace(origin, rays), self._moving.trace(origin, rays)
        return moving.where(moving.distance < still.distance, still)


def _open3d() -> Any:
    try:
        import open3d
    except ImportError as error:
        raise MissingDependencyError("ray casting needs Open3D: pip install open3d-cpu (elsewhere: open3d)") from error
    return open3d
