"""Things that stand in a simulated street or building, each with sizes of its own."""

from __future__ import annotations

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.simulation.glazing import Glazing, pane_mesh
from svc_ros.simulation.meshes import Mesh, box, cylinder, extrusion, foliage, from_quads, join, relief, upright

FOUNDATION_M = 0.6  # bodies reach below the ground, so that a slope opens no gap under them


def house(rng: np.random.Generator, width_m: float) -> Mesh:
    """House with its front on y = 0, looking along +y: set-back windows and doors, balconies, a pitched roof."""
    return glazed_house(rng, width_m, None)[0]


def glazed_house(rng: np.random.Generator, width_m: float, glazing: Glazing | None) -> tuple[Mesh, Mesh]:
    """The same house, in which the glazed windows are holes to its inside; and their panes."""
    floors, floor_m, depth_m = int(rng.integers(2, 6)), rng.uniform(2.7, 3.4), rng.uniform(8.0, 15.0)
    height = floors * floor_m + rng.uniform(0.3, 1.2)
    x, z, depth = _openings(rng, width_m, floors, floor_m)
    is_open = np.zeros(depth.shape, np.bool_)
    if glazing is not None:
        is_open[1::2, 1::2] = glazing.chosen(len(x) // 2 - 1, floors)
        is_open[1::2, :2] |= glazing.chosen()  # a shop, glass down to the ground
    front = relief(x, np.r_[z, height], depth, is_open)
    parts = [front, _shell(width_m, depth_m, height), _roof(rng, width_m, depth_m, height)]
    parts += [box((rng.uniform(2.0, 3.5), 1.1, 1.1), (0.5 * (x[2 * c + 1] + x[2 * c + 2]), 0.55, floor * floor_m))
              for floor in range(1, floors) for c in range((len(x) - 2) // 2) if rng.random() < 0.12]  # fmt: skip
    if glazing is not None:
        parts.append(_inside(glazing.rng, (width_m, depth_m), (floors, floor_m)))
    holes = [(x[i], x[i + 1], z[k], z[k + 1]) for i, k in np.argwhere(is_open)]
    return join(parts), pane_mesh(holes, depth[is_open])


def _inside(rng: np.random.Generator, size: tuple[float, float], storeys: tuple[int, float]) -> Mesh:
    """Floors, and rooms of different depths with a cupboard each, behind a front of `size` (width, depth) [m]."""
    (width, deep), (floors, floor_m), parts = size, storeys, []
    for floor in range(floors):
        z, back = floor * floor_m, rng.uniform(2.5, 6.0)
        parts.append(box((width - 0.1, deep - 0.5, 0.2), (0.0, -0.5 * deep, z - 0.15)))
        parts.append(box((width - 0.1, 0.1, floor_m), (0.0, -back, z)))
        for place in np.arange(-0.5 * width + rng.uniform(2.0, 4.0), 0.5 * width - 1.0, rng.uniform(3.0, 5.0)):
            parts.append(box((0.1, back - 0.5, floor_m), (place, -0.5 * (back + 0.5), z)))
            cupboard = (*rng.uniform(0.4, 1.2, 2), rng.uniform(0.7, 2.0))
            parts.append(box(cupboard, (place + 0.9, -rng.uniform(1.2, 2.0), z)))
    return join(parts)


def _openings(rng: np.random.Generator, width_m: float, floors: int, floor_m: float) -> tuple[Array, Array, Array]:
    columns = max(1, int(width_m / rng.uniform(2.2, 3.4)))
    pitch, opening = width_m / columns, rng.uniform(0.9, 1.5)
    left = (np.arange(columns) + 0.5) * pitch + rng.uniform(-0.3, 0.3, columns) - 0.5 * opening - 0.5 * width_m
    x = np.r_[-0.5 * width_m, np.stack([left, left + opening], -1).ravel(), 0.5 * width_m]
    sill, head = rng.uniform(0.7, 1.0), rng.uniform(2.1, 2.4)
    storeys = np.arange(floors) * floor_m
    z = np.r_[-FOUNDATION_M, np.stack([storeys + sill, storeys + head], -1).ravel()]
    depth = np.zeros((len(x) - 1, len(z)))
    recess = np.where(rng.random((columns, floors)) < 0.85, rng.uniform(0.12, 0.35), 0.0)
    depth[1::2, 1::2] = recess
    door = rng.integers(columns)
    depth[2 * door + 1, :2] = rng.uniform(0.4, 1.2)
    return x, z, depth


def _shell(width_m: float, depth_m: float, height: float) -> Mesh:
    body = box((width_m, depth_m, height + FOUNDATION_M), (0.0, -0.5 * depth_m, -FOUNDATION_M))
    quads = body.vertices.reshape(-1, 4, 3)
    return from_quads(quads[np.abs(quads[..., 1]).max(1) > 0.0])  # the front is the relief's


def _roof(rng: np.random.Generator, width_m: float, depth_m: float, height: float) -> Mesh:
    ridge, eaves = rng.uniform(1.5, 4.5), rng.uniform(0.2, 0.6)
    profile = [(0.5 * depth_m + eaves, height), (0.0, height + ridge), (-0.5 * depth_m - eaves, height)]
    gable = extrusion(profile, width_m)
    chimney = box((0.7, 0.7, ridge + 1.0), (rng.uniform(-0.3, 0.3) * width_m, -0.6 * depth_m, height))
    return join([gable.moved(upright(0.0, -0.5 * depth_m, 0.0, np.pi / 2)), chimney])


def car(rng: np.random.Generator) -> Mesh:
    """Car or van that drives along +x, on its wheels."""
    length, width, height = rng.uniform(3.7, 4.9), rng.uniform(1.65, 1.9), rng.uniform(1.4, 1.65)
    side = [(0.0, 0.25), (0.5, 0.25), (0.5, 0.75), (0.28, 0.85), (0.1, height), (-0.3, height)]
    side += [(-0.45, 0.95), (-0.5, 0.25)]
    if rng.random() < 0.2:
        length, height = rng.uniform(4.8, 6.2), rng.uniform(1.9, 2.6)
        side = [(0.0, 0.25), (0.5, 0.25), (0.5, 1.0), (0.38, 1.1), (0.27, height), (-0.5, height), (-0.5, 0.25)]
    body = extrusion(np.array(side) * [length, 1.0], width)
    wheel = cylinder(0.32, 0.64, sides=8)  # upright drums fill the wheel houses well enough for a LiDAR
    wheels = [wheel.moved(upright(a * length, b * (0.5 * width - 0.33))) for a in (-0.3, 0.3) for b in (-1, 1)]
    return join([body, *wheels])


def tree(rng: np.random.Generator) -> Mesh:
    """Trunk, two or three limbs and a crown of loose leaves."""
    trunk_m, radius = rng.uniform(1.8, 3.2), rng.uniform(1.2, 2.4)
    height = trunk_m + 1.6 * radius
    parts = [cylinder(rng.uniform(0.12, 0.28), height + FOUNDATION_M, 0.06).moved(upright(0, 0, -FOUNDATION_M))]
    for _ in range(int(rng.integers(2, 4))):
        radii = radius * rng.uniform(0.5, 1.0, 3)
        x, y = rng.uniform(-0.5, 0.5, 2) * radius
        crown = foliage(rng, radii, int(90 * radius), 0.18)
        parts.append(crown.moved(upright(x, y, trunk_m + radius * rng.uniform(0.5, 1.1))))
    return join(parts)


def pole(rng: np.random.Generator) -> Mesh:
    """Street lamp with its arm along +y, or a post with a sign."""
    if rng.random() < 0.5:
        height = rng.uniform(4.5, 8.0)
        arm = box((0.25, rng.uniform(0.8, 2.0), 0.15), (0.0, 0.8, height))
        return join([cylinder(rng.uniform(0.07, 0.12), height + 0.5, sides=8).moved(upright(0, 0, -0.5)), arm])
    height = rng.uniform(2.0, 3.0)
    plate = box((0.03, *rng.uniform(0.5, 0.9, 2)), (0.04, 0.0, height - 0.3))
    post = cylinder(0.04, height + 0.5, sides=6).moved(upright(0, 0, -0.5))
    return join([post, plate.moved(upright(0, 0, 0, rng.uniform(-0.6, 0.6)))])


def clutter(rng: np.random.Generator) -> Mesh:
    """Bins, a bench, a cabinet: a few boxes in no order."""
    sizes = rng.uniform((0.4, 0.4, 0.5), (1.6, 0.8, 1.4), (int(rng.integers(1, 4)), 3))
    spots = rng.uniform((-1.5, -0.2), (1.5, 0.2), (len(sizes), 2))
    poses = [upright(x, y, 0.0, rng.uniform(-0.4, 0.4)) for x, y in spots]
    return join(box(size).moved(pose) for size, pose in zip(sizes, poses, strict=True))


def person(rng: np.random.Generator) -> Mesh:
    """Standing person: legs, trunk, head."""
    height = rng.uniform(1.55, 1.95)
    legs = [cylinder(0.09, 0.5 * height, sides=6).moved(upright(0.0, y)) for y in (-0.12, 0.12)]
    trunk = box((0.26, 0.46, 0.36 * height), (0.0, 0.0, 0.48 * height))
    return join([*legs, trunk, cylinder(0.1, 0.16 * height, sides=8).moved(upright(0, 0, 0.84 * height))])


def table(rng: np.random.Generator) -> Mesh:
    """Table with four legs and its chairs."""
    length, width, height = rng.uniform(1.0, 2.4), rng.uniform(0.7, 1.1), rng.uniform(0.7, 0.78)
    legs = [box((0.06, 0.06, height), (a * length, b * width, 0.0)) for a in (-0.45, 0.45) for b in (-0.42, 0.42)]
    chairs = [_chair().moved(upright(rng.uniform(-0.4, 0.4) * length, side * (0.5 * width + 0.25), 0.0,
                                     -side * np.pi / 2 + rng.uniform(-0.5, 0.5)))
              for side in (-1, 1) for _ in range(int(rng.integers(0, 3)))]  # fmt: skip
    return join([box((length, width, 0.04), (0.0, 0.0, height)), *legs, *chairs])


def _chair() -> Mesh:
    legs = [box((0.04, 0.04, 0.44), (a, b, 0.0)) for a in (-0.19, 0.19) for b in (-0.19, 0.19)]
    return join([*legs, box((0.44, 0.44, 0.05), (0.0, 0.0, 0.44)), box((0.04, 0.42, 0.45), (-0.2, 0.0, 0.49))])


def shelf(rng: np.random.Generator) -> Mesh:
    """Shelf against a wall on y = 0, open along +y, its compartments filled to different depths."""
    width, height, deep = rng.uniform(0.8, 2.4), rng.uniform(1.0, 2.2), rng.uniform(0.3, 0.6)
    columns, rows = int(rng.integers(2, 5)), int(rng.integers(2, 6))
    depth = np.where(rng.random((columns, rows)) < 0.6, rng.uniform(0.05, 0.25, (columns, rows)), 0.0)
    front = relief(np.linspace(-0.5, 0.5, columns + 1) * width, np.linspace(0.0, height, rows + 1), depth)
    quads = box((width, deep, height), (0.0, -0.5 * deep, 0.0)).vertices.reshape(-1, 4, 3)
    open_box = from_quads(quads[np.abs(quads[..., 1]).max(1) > 0.0])
    return join([front, open_box]).moved(upright(0.0, deep))


def wall(length_m: float, height_m: float, openings: list[tuple[float, float, float, float]]) -> Mesh:
    """Wall 0.15 m thick along x from 0 to `length_m`, with openings (from, to, bottom, top) [m], in order, apart."""
    pieces, start = [], 0.0
    for left, right, bottom, top in [*openings, (length_m, length_m, 0.0, height_m)]:
        pieces += [(start, left, 0.0, height_m), (left, right, 0.0, bottom), (left, right, top, height_m)]
        start = right
    return join(box((b - a, 0.15, d - c), (0.5 * (a + b), 0.0, c)) for a, b, c, d in pieces if b > a and d > c)
