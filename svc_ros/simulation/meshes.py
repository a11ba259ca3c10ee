"""Triangle meshes of simple bodies, as plain arrays.

Bodies stand on z = 0 of their own frame, x along their length; `Mesh.moved` places them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import se3
from svc_ros.core.scan import Array, IndexArray

_BOX_QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices: (V, 3) [m]; triangles: (T, 3) vertex indices. Both sides of a triangle are solid to a ray."""

    vertices: Array
    triangles: IndexArray

    def moved(self, T: ArrayLike) -> Mesh:
        """Return the mesh mapped by one pose (4, 4)."""
        return Mesh(se3.apply(T, self.vertices), self.triangles)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh of all the triangles, in order; of nothing, an empty mesh."""
    parts = list(meshes)
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = [part.vertices for part in parts]
    triangles = [part.triangles + offset for part, offset in zip(parts, offsets, strict=False)]
    return Mesh(np.concatenate([np.zeros((0, 3)), *vertices]), np.concatenate([np.zeros((0, 3), np.int64), *triangles]))


def upright(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Array:
    """Pose (4, 4) of a body at (x, y, z) [m], turned by `yaw` [rad] about the vertical."""
    c, s = np.cos(yaw), np.sin(yaw)
    return se3.make_pose([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], [x, y, z])


def from_quads(quads: ArrayLike) -> Mesh:
    """Mesh of quads (Q, 4, 3) [m], corners in order round each quad."""
    corners = np.asarray(quads, np.float64).reshape(-1, 3)
    first = np.arange(0, len(corners), 4)[:, None]
    return Mesh(corners, np.concatenate([first + np.array(corner) for corner in ((0, 1, 2), (0, 2, 3))]))


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Mesh:
    """Box of `size` (3,) [m] whose bottom face is centred at `centre` (3,) [m]."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    return from_quads((corners * np.asarray(size) + np.asarray(centre))[_BOX_QUADS])


def cylinder(radius: float, height: float, top_radius: float | None = None, sides: int = 12) -> Mesh:
    """Closed upright cylinder, or the stump of a cone if `top_radius` [m] is given."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], -1)
    top = ring * (radius if top_radius is None else top_radius) + [0.0, 0.0, height]
    vertices = np.concatenate([ring * radius, top, [[0.0, 0.0, height]]])
    i, j = np.arange(sides), np.roll(np.arange(sides), -1)
    walls = [np.stack([i, j, j + sides], -1), np.stack([i, j + sides, i + sides], -1)]
    return Mesh(vertices, np.concatenate([*walls, np.stack([i + sides, j + sides, np.full(sides, 2 * sides)], -1)]))


def extrusion(profile: ArrayLike, width: float) -> Mesh:
    """Body of a side view `profile` (P, 2) of (x, z) [m], `width` [m] wide along y, centred.

    The profile must be visible as a whole from its first point, which closes the two sides as a fan.
    """
    outline = np.asarray(profile, np.float64)
    n = len(outline)
    sides = [np.insert(outline, 1, y, axis=1) for y in (-0.5 * width, 0.5 * width)]
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    fan = np.stack([np.zeros(n - 2, np.int64), np.arange(1, n - 1), np.arange(2, n)], -1)
    walls = [np.stack([i, j, j + n], -1), np.stack([i, j + n, i + n], -1)]
    return Mesh(np.concatenate(sides), np.concatenate([fan, fan + n, *walls]))


def sheet(points: ArrayLike) -> Mesh:
    """Surface through a grid of points (A, B, 3) [m]."""
    grid = np.asarray(points, np.float64)
    return from_quads(np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], 2).reshape(-1, 4, 3))


def relief(x: ArrayLike, z: ArrayLike, depth: ArrayLike, is_open: ArrayLike | None = None) -> Mesh:
    """Upright wall that looks along +y, with every cell set back by its own depth.

    x: (A+1,) and z: (B+1,) borders of the cells [m], ascending; depth: (A, B) [m], positive is away from the viewer;
    is_open: (A, B), cells that are holes.
    """
    x, z, depth = (np.asarray(a, np.float64) for a in (x, z, depth))
    x0, z0 = np.meshgrid(x[:-1], z[:-1], indexing="ij")
    x1, z1 = np.meshgrid(x[1:], z[1:], indexing="ij")
    closed = np.ones(depth.shape, np.bool_) if is_open is None else ~np.asarray(is_open)
    fronts = _quads(*(a[closed] for a in (x0, x1, z0, z1, -depth, -depth)))
    reveals = _quads(x1[:-1], x1[:-1], z0[:-1], z1[:-1], -depth[:-1], -depth[1:])
    lintels = _lintels(x0[:, :-1], x1[:, :-1], z1[:, :-1], -depth[:, :-1], -depth[:, 1:])
    return from_quads(np.concatenate([fronts, reveals, lintels]))


def _quads(x0: Array, x1: Array, z0: Array, z1: Array, y0: Array, y1: Array) -> Array:
    corners = [(x0, y0, z0), (x1, y1, z0), (x1, y1, z1), (x0, y0, z1)]
    quads = np.stack([np.stack(c, -1) for c in corners], -2).reshape(-1, 4, 3)
    return quads[np.ptp(quads, axis=1).astype(bool).sum(-1) > 1]  # a step of no depth has no face


def _lintels(x0: Array, x1: Array, z: Array, y0: Array, y1: Array) -> Array:
    corners = [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]
    quads = np.stack([np.stack(c, -1) for c in corners], -2).reshape(-1, 4, 3)
    return quads[np.ptp(quads, axis=1).astype(bool).sum(-1) > 1]


def foliage(rng: np.random.Generator, radii: ArrayLike, num_leaves: int, leaf_m: float) -> Mesh:
    """Loose triangles in an ellipsoid of `radii` (3,) [m] about the origin: rays pass between them, as in a tree."""
    direction = rng.normal(size=(num_leaves, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centre = direction * rng.uniform(0.35, 1.0, (num_leaves, 1)) * np.asarray(radii)
    corners = centre[:, None] + rng.normal(scale=leaf_m, size=(num_leaves, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * num_leaves).reshape(-1, 3))
