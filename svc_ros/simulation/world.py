"""What a simulated world consists of: things, the tracks they move on, the way of the carrier."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import se3
from svc_ros.core.errors import ConfigError, InputError
from svc_ros.core.scan import Array
from svc_ros.simulation.meshes import Mesh

HeightField = Callable[[Array, Array], Array]
GLASS = "glass"  # kind of the objects that let light through
_SLOPE_STEP_M = 1.0


@dataclass(frozen=True, eq=False)
class Track:
    """A curve on the ground that something drives or walks along.

    points: (M, 3) [m], dense and in order; up: (M, 3) unit normals of the ground under them.
    """

    points: Array
    up: Array

    @classmethod
    def on_ground(cls, xy: ArrayLike, ground: HeightField) -> Track:
        """Lay a curve (M, 2) [m] onto the ground z(x, y)."""
        x, y = np.asarray(xy, np.float64).T
        dx, dy = np.array([_SLOPE_STEP_M, 0.0]), np.array([0.0, _SLOPE_STEP_M])
        slope = [(ground(x + d[0], y + d[1]) - ground(x - d[0], y - d[1])) / (2 * _SLOPE_STEP_M) for d in (dx, dy)]
        up = np.stack([-slope[0], -slope[1], np.ones_like(x)], -1)
        return cls(np.stack([x, y, ground(x, y)], -1), up / np.linalg.norm(up, axis=1, keepdims=True))

    @property
    def distances(self) -> Array:
        """(M,) way along the curve to every point [m]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @property
    def length_m(self) -> float:
        """Length of the curve [m]."""
        return float(self.distances[-1])

    def pose(self, distance_m: float) -> Array:
        """Pose (4, 4) of a body `distance_m` along the curve: x ahead, z along the ground's normal."""
        way = self.distances
        if not 0.0 <= distance_m <= way[-1]:
            raise InputError(f"track: expected a way within 0 and {way[-1]:.1f} m, found {distance_m:.1f} m")
        ahead = self._at(min(distance_m + 0.5, way[-1])) - self._at(max(distance_m - 0.5, 0.0))
        up = np.array([np.interp(distance_m, way, self.up[:, i]) for i in range(3)])
        left = np.cross(up, ahead)
        axes = [np.cross(left, up), left, up]
        return se3.make_pose(np.stack([a / np.linalg.norm(a) for a in axes], -1), self._at(distance_m))

    def reversed(self) -> Track:
        """The same curve, driven the other way."""
        return Track(self.points[::-1], self.up[::-1])

    def _at(self, distance_m: float) -> Array:
        way = self.distances
        return np.array([np.interp(distance_m, way, self.points[:, i]) for i in range(3)])


@dataclass(frozen=True, eq=False)
class Motion:
    """Travel along a track: `start_m` [m] at time zero, then `speed_mps` [m/s]."""

    track: Track
    start_m: float
    speed_mps: float

    def pose(self, time_s: float) -> Array | None:
        """Pose (4, 4) at a time, or None where the track has ended."""
        distance = self.start_m + self.speed_mps * time_s
        return self.track.pose(distance) if 0.0 <= distance <= self.track.length_m else None


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One thing: its mesh stands in the world, or, where it has a motion, in the frame that moves.

    kind: `house`, `car`, ...; leaves_at_s: from this time on it is gone (a parked car that drove off).
    """

    kind: str
    mesh: Mesh
    motion: Motion | None = None
    leaves_at_s: float = np.inf

    @property
    def is_static(self) -> bool:
        """True if it is there and at the same place at all times."""
        return self.motion is None and np.isinf(self.leaves_at_s)

    def mesh_at(self, time_s: float) -> Mesh | None:
        """The mesh in the world at a time, or None where it is not there."""
        if time_s >= self.leaves_at_s:
            return None
        if self.motion is None:
            return self.mesh
        pose = self.motion.pose(time_s)
        return None if pose is None else self.mesh.moved(pose)


@dataclass(frozen=True, eq=False)
class Scene:
    """A world (z up) and a way through it; sensor_height_m: of the carrier's sensor above the ground."""

    name: str
    objects: tuple[SceneObject, ...]
    track: Track
    sensor_height_m: float

    def kinds(self) -> list[str]:
        """Kind of every object, in the order of `objects`."""
        return [thing.kind for thing in self.objects]


@dataclass(frozen=True)
class SceneConfig:
    """length_m: way of the carrier that the scene must offer [m]; moving_share: share of cars or people that move or
    leave, in [0, 1]; speed_mps: of the carrier [m/s], so that nothing runs into it; glass_share: share of the windows,
    shop fronts and partitions that are panes to look through (objects of kind `glass`), in [0, 1]."""

    length_m: float = 60.0
    moving_share: float = 0.15
    speed_mps: float = 5.0
    glass_share: float = 0.0

    def __post_init__(self) -> None:
        if not self.length_m > 0.0 or not 0.0 <= self.moving_share <= 1.0 or not self.speed_mps >= 0.0:
            raise ConfigError(f"scene: expected length_m > 0, moving_share in [0, 1], speed_mps >= 0, found {self}")
        if not 0.0 <= self.glass_share <= 1.0:
            raise ConfigError(f"scene: expected glass_share in [0, 1], found {self.glass_share}")


def side_generator(rng: np.random.Generator) -> np.random.Generator:
    """A generator of its own for what is not always drawn, so that `rng` goes on as if nothing had been."""
    return np.random.default_rng(copy.deepcopy(rng).integers(2**63))
