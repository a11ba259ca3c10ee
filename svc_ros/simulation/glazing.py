"""Which openings of a building hold panes, and where more are made for panes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.scan import Array
from svc_ros.simulation.meshes import Mesh, from_quads
from svc_ros.simulation.world import GLASS, SceneObject, side_generator

Opening = tuple[float, float, float, float]  # of a wall along x: from, to, bottom, top [m]
_FRAME_M, _LEAST_M, _HEAD_M = 0.15, 0.8, 2.4  # around a pane that takes a wall's place; its least width; its top


@dataclass(frozen=True, eq=False)
class Glazing:
    """share: of what can be glass, that is, in [0, 1]; the rest follows from a generator of its own."""

    rng: np.random.Generator
    share: float

    @classmethod
    def beside(cls, rng: np.random.Generator, share: float) -> Glazing:
        """Glazing of a scene that `rng` builds; nothing is drawn from `rng`."""
        return cls(side_generator(rng), share)

    def chosen(self, *shape: int) -> NDArray[np.bool_]:
        """Mask (shape) of what is glass."""
        return np.asarray(self.rng.random(shape) < self.share)

    def instead_of_wall(self, stretches: Sequence[tuple[float, float]], height_m: float) -> list[Opening]:
        """Openings where a share of the stretches (from, to) [m] of a wall is glass; short ones never are."""
        framed = [(a + _FRAME_M, b - _FRAME_M) for a, b in stretches]
        top = min(_HEAD_M, height_m - _FRAME_M)
        return [(a, b, 0.1, top) for (a, b), glass in zip(framed, self.chosen(len(framed)), strict=True)
                if glass and b - a > _LEAST_M]  # fmt: skip

    def panes_in(self, openings: Sequence[Opening], pose: Array) -> list[SceneObject]:
        """Panes in a share of a wall's openings; the wall stands at `pose` (4, 4)."""
        return panes([o for o, glass in zip(openings, self.chosen(len(openings)), strict=True) if glass], pose)


def panes(openings: Sequence[Opening], pose: Array) -> list[SceneObject]:
    """A pane in each opening of the wall that stands at `pose` (4, 4), as one object; of none, no object."""
    return [SceneObject(GLASS, pane_mesh(openings).moved(pose))] if openings else []


def pane_mesh(openings: Sequence[Opening], depth_m: ArrayLike | None = None) -> Mesh:
    """Panes in openings of a wall along x, each set back from it by its depth [m]."""
    a, b, bottom, top = np.reshape(openings, (-1, 4)).T
    y = np.zeros(len(a)) if depth_m is None else -np.asarray(depth_m, np.float64)
    corners = [(a, y, bottom), (b, y, bottom), (b, y, top), (a, y, top)]
    return from_quads(np.stack([np.stack(corner, -1) for corner in corners], 1))
