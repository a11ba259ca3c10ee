"""A street of houses with side streets, trees and traffic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.simulation import bodies
from svc_ros.simulation.glazing import Glazing
from svc_ros.simulation.meshes import Mesh, box, join, sheet, upright
from svc_ros.simulation.world import GLASS, HeightField, Motion, Scene, SceneConfig, SceneObject, Track

_MARGIN_M = 70.0  # the street goes on before and after the carrier's way
_KERB_M = 0.13
_LANE_M = 1.6  # middle of a lane, off the middle of the road
_SENSOR_HEIGHT_M = 1.8


@dataclass(frozen=True, eq=False)
class _Road:
    """The middle line (M, 2) [m] with its headings (M,), half of the carriageway's width, the ground."""

    middle: Array
    heading: Array
    half_width_m: float
    ground: HeightField
    length_m: float

    def place(self, along_m: float, left_m: float, yaw: float = 0.0, kerb: bool = True) -> Array:
        """Pose (4, 4) of a body at a way along the middle line and a distance to its left."""
        i = np.clip((along_m + _MARGIN_M) / 0.5, 0, len(self.middle) - 1).astype(int)
        x, y = self.middle[i] + left_m * np.array([-np.sin(self.heading[i]), np.cos(self.heading[i])])
        z = float(self.ground(x, y)) + (_KERB_M if kerb and abs(left_m) > self.half_width_m else 0.0)
        return upright(x, y, z, self.heading[i] + yaw)

    def lane(self, left_m: float | Array) -> Track:
        """Track parallel to the middle line, from the street's start to its end."""
        return Track.on_ground(self.offset(left_m), self.ground)

    def offset(self, left_m: float | Array) -> Array:
        """Curve (M, 2) at a distance to the left of the middle line."""
        normal = np.stack([-np.sin(self.heading), np.cos(self.heading)], -1)
        return np.asarray(self.middle + np.broadcast_to(left_m, len(normal))[:, None] * normal)


def build_street(rng: np.random.Generator, config: SceneConfig) -> Scene:
    """Street with bends and a gentle slope; the carrier drives on the right."""
    road = _lay_road(rng, config.length_m)
    glazing = Glazing.beside(rng, config.glass_share) if config.glass_share > 0.0 else None
    objects = [SceneObject("ground", _ground_mesh(road))]
    for side in (-1, 1):
        objects += _houses(rng, road, side, glazing)
        objects += _street_furniture(rng, road, side)
    objects += _parked_cars(rng, road, config.moving_share)
    objects += _traffic(rng, road, config)
    way = np.arange(len(road.middle)) * 0.5
    sway = 0.3 * np.sin(2 * np.pi * way / rng.uniform(25.0, 40.0))
    inside = (way >= _MARGIN_M) & (way <= _MARGIN_M + config.length_m + 5.0)
    track = Track.on_ground(road.offset(-_LANE_M + sway)[inside], road.ground)
    return Scene("street", tuple(objects), track, _SENSOR_HEIGHT_M)


def _lay_road(rng: np.random.Generator, length_m: float) -> _Road:
    way = np.arange(0.0, length_m + 2 * _MARGIN_M, 0.5)
    bends = zip(rng.uniform(0.08, 0.22, 3), rng.uniform(110.0, 260.0, 3), rng.uniform(0.0, 6.3, 3), strict=True)
    heading = np.sum([a * np.sin(2 * np.pi * way / wave + phase) for a, wave, phase in bends], axis=0)
    steps = 0.5 * np.stack([np.cos(heading), np.sin(heading)], -1)
    return _Road(np.cumsum(steps, axis=0), heading, rng.uniform(4.9, 5.6), _rolling_ground(rng), length_m)


def _rolling_ground(rng: np.random.Generator) -> HeightField:
    wave, turn, phase = rng.uniform(25.0, 90.0, 5), rng.uniform(0.0, 6.3, 5), rng.uniform(0.0, 6.3, 5)
    height = 0.004 * wave
    kx, ky = 2 * np.pi * np.cos(turn) / wave, 2 * np.pi * np.sin(turn) / wave

    def ground(x: Array, y: Array) -> Array:
        phases = np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + phase
        return np.asarray(np.sin(phases) @ height)

    return ground


def _ground_mesh(road: _Road) -> Mesh:
    edge = road.half_width_m
    inner = [0.0, 1.6, 3.2]
    outer = [edge + 0.01, edge + 1.5, edge + 3.0, 11.0, 16.0, 24.0, 36.0, 55.0]
    right = [(d, 0.0) for d in [*inner, edge]] + [(d, _KERB_M) for d in outer]
    profile = [(-d, rise) for d, rise in reversed(right)] + right[1:]
    every = slice(None, None, 4)
    lines = []
    for left, rise in profile:
        x, y = road.offset(left)[every].T
        lines.append(np.stack([x, y, road.ground(x, y) + rise], -1))
    return sheet(np.stack(lines, 1))


def _along(rng: np.random.Generator, road: _Road, gap_m: tuple[float, float]) -> Iterator[float]:
    """Places along the street with random gaps, from its start to its end."""
    place = -_MARGIN_M + rng.uniform(0.0, gap_m[1])
    while place < road.length_m + _MARGIN_M - 5.0:
        yield place
        place += rng.uniform(*gap_m)


def _houses(rng: np.random.Generator, road: _Road, side: int, glazing: Glazing | None) -> list[SceneObject]:
    facing = np.pi if side > 0 else 0.0
    objects, place = [], -_MARGIN_M
    pavement = road.half_width_m + rng.uniform(2.2, 3.2)
    while place < road.length_m + _MARGIN_M - 10.0:
        width, setback = rng.uniform(6.0, 16.0), rng.choice([0.0, 0.0, 0.6, 1.5, 3.0, 4.5])
        middle = place + 0.5 * width
        pose = road.place(middle, side * (pavement + setback), facing + rng.normal(scale=0.02))
        mesh, panes = bodies.glazed_house(rng, width, glazing)
        objects.append(SceneObject("house", mesh.moved(pose)))
        if len(panes.triangles):
            objects.append(SceneObject(GLASS, panes.moved(pose)))
        if setback > 1.0:
            objects.append(_garden(rng, road.place(middle, side * pavement, facing), width))
        place += width + rng.choice([0.0, 0.0, 0.8, 2.5])
        if rng.random() < 0.22:
            gap = rng.uniform(7.0, 12.0)
            objects += _side_street(rng, road, place + 0.5 * gap, side)
            place += gap
    return objects


def _garden(rng: np.random.Generator, pose: Array, width: float) -> SceneObject:
    height, gate = rng.uniform(0.5, 1.5), rng.uniform(0.1, 0.7)
    pieces = [(-0.5, gate - 0.5), (gate - 0.5 + 1.4 / width, 0.5)]
    sizes = [((b - a) * width, 0.25, height + 0.5) for a, b in pieces]
    mesh = join(box(s, (0.5 * (a + b) * width, 0.0, -0.5)) for s, (a, b) in zip(sizes, pieces, strict=True) if b > a)
    return SceneObject("wall", mesh.moved(pose))


def _side_street(rng: np.random.Generator, road: _Road, place: float, side: int) -> list[SceneObject]:
    """Something at the end of a gap between houses, and something in it."""
    facing = np.pi if side > 0 else 0.0
    end = road.place(place + rng.uniform(-2, 2), side * rng.uniform(28.0, 45.0), facing + rng.uniform(-0.4, 0.4))
    objects = [SceneObject("house", bodies.house(rng, rng.uniform(10.0, 18.0)).moved(end))]
    car = road.place(place + rng.uniform(-3, 3), side * rng.uniform(14.0, 22.0), np.pi / 2 + rng.normal(scale=0.1))
    objects.append(SceneObject("car", bodies.car(rng).moved(car)))
    tree = road.place(place + rng.uniform(-3, 3), side * rng.uniform(20.0, 27.0))
    objects.append(SceneObject("tree", bodies.tree(rng).moved(tree)))
    return objects


_Body = Callable[[np.random.Generator], Mesh]


def _street_furniture(rng: np.random.Generator, road: _Road, side: int) -> list[SceneObject]:
    rows: list[tuple[str, _Body, tuple[float, float], tuple[float, float]]] = [
        ("tree", bodies.tree, (7.0, 26.0), (0.7, 1.2)),
        ("pole", bodies.pole, (9.0, 24.0), (0.3, 0.6)),
        ("clutter", bodies.clutter, (8.0, 24.0), (1.5, 2.0)),
        ("person", bodies.person, (15.0, 50.0), (0.8, 2.0)),
    ]
    objects = []
    for kind, body, gap, kerb in rows:
        for place in _along(rng, road, gap):
            facing = (np.pi if side > 0 else 0.0) + rng.normal(scale=0.2)
            pose = road.place(place, side * (road.half_width_m + rng.uniform(*kerb)), facing)
            objects.append(SceneObject(kind, body(rng).moved(pose)))
    return objects


def _parked_cars(rng: np.random.Generator, road: _Road, moving_share: float) -> list[SceneObject]:
    """Cars along both kerbs; half of the moving share drives off within the first minute."""
    objects = []
    for side in (-1, 1):
        for place in _along(rng, road, (6.6, 19.0)):
            yaw = rng.choice([0.0, np.pi]) + rng.normal(scale=0.03)
            pose = road.place(place, side * (road.half_width_m - rng.uniform(1.05, 1.25)), yaw)
            leaves = rng.uniform(0.0, 60.0) if rng.random() < 0.5 * moving_share else np.inf
            objects.append(SceneObject("car", bodies.car(rng).moved(pose), leaves_at_s=leaves))
    return objects


def _traffic(rng: np.random.Generator, road: _Road, config: SceneConfig) -> list[SceneObject]:
    """Oncoming cars, one ahead and one behind at the carrier's pace, people on the pavement."""
    if config.moving_share == 0.0:
        return []
    own, oncoming = road.lane(-_LANE_M), road.lane(_LANE_M).reversed()
    pace = config.speed_mps
    ahead = Motion(own, _MARGIN_M + rng.uniform(17.0, 26.0), pace * 1.05)
    behind = Motion(own, _MARGIN_M - rng.uniform(15.0, 24.0), pace * 0.97)
    motions = [ahead, behind]
    spacing = 12.0 / config.moving_share
    for start in np.arange(rng.uniform(0.0, spacing), oncoming.length_m, spacing):
        motions.append(Motion(oncoming, start + rng.uniform(-2.0, 2.0), rng.uniform(4.0, 6.0)))
    objects = [SceneObject("car", bodies.car(rng), motion) for motion in motions]
    pavement = road.lane(float(rng.choice([-1, 1])) * (road.half_width_m + 1.8))
    for start in np.arange(rng.uniform(0.0, spacing), pavement.length_m, spacing):
        objects.append(SceneObject("person", bodies.person(rng), Motion(pavement, start, rng.uniform(-1.6, 1.6))))
    return objects
