"""Halls and rooms along a corridor, and a corridor with nothing in it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from svc_ros.core.scan import Array
from svc_ros.simulation import bodies
from svc_ros.simulation.glazing import Glazing, panes
from svc_ros.simulation.meshes import Mesh, box, cylinder, join, upright
from svc_ros.simulation.world import Motion, Scene, SceneConfig, SceneObject, Track

_SENSOR_HEIGHT_M = 1.2
_DOOR_HEIGHT_M = 2.1
_CORRIDOR_END_M = 200.0  # beyond every sensor's range


def _flat(x: Array, y: Array) -> Array:
    return np.zeros_like(x)


def build_indoor(rng: np.random.Generator, config: SceneConfig) -> Scene:
    """A hall, a corridor with rooms on both sides and a second hall; the carrier goes from one hall into the other."""
    glazing = Glazing.beside(rng, config.glass_share) if config.glass_share > 0.0 else None
    length, width, height = max(config.length_m - 8.0, 8.0), rng.uniform(2.7, 3.4), rng.uniform(2.7, 3.2)
    objects = _hall(rng, upright(0.0, 0.0, 0.0, np.pi), (width, height), glazing)
    objects += _hall(rng, upright(length, 0.0), (width, height), glazing)
    for side in (-1, 1):
        objects += _room_row(rng, side, (length, width, height), glazing)
    objects += _corridor_things(rng, length, width)
    floor = box((length + 30.0, 40.0, 0.2), (0.5 * length, 0.0, -0.2))
    ceiling = box((length + 30.0, 40.0, 0.2), (0.5 * length, 0.0, height))
    objects += [SceneObject("floor", floor), SceneObject("ceiling", join([ceiling, _lamps(rng, length, height)]))]
    track = _walk(rng, length)
    objects += _walkers(rng, track, config)
    return Scene("indoor", tuple(objects), track, _SENSOR_HEIGHT_M)


def _walk(rng: np.random.Generator, length: float) -> Track:
    bends = np.arange(2.5, length - 2.4, 5.0)
    inside = np.stack([bends, rng.uniform(-0.35, 0.35, len(bends))], -1)
    start = [[-6.0, rng.uniform(-2.5, 2.5)], [-2.5, 0.3]]
    end = [[length + 2.5, -0.3], [length + 6.0, rng.uniform(-2.5, 2.5)]]
    knots = np.concatenate([start, inside, end])
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))]
    return Track.on_ground(CubicSpline(way, knots)(np.arange(0.0, way[-1], 0.1)), _flat)


def _hall(
    rng: np.random.Generator, pose: Array, corridor: tuple[float, float], glazing: Glazing | None
) -> list[SceneObject]:
    """Hall in the half space x > 0 of `pose`, open to the corridor (width, height) [m] at its origin."""
    corridor_m, height = corridor
    deep, left, right = rng.uniform(9.0, 13.0), rng.uniform(4.5, 7.5), rng.uniform(4.5, 7.5)
    wide, middle = left + right, 0.5 * (left - right)
    entry = (right - 0.5 * corridor_m, right + 0.5 * corridor_m, 0.0, height)
    ahead, beside = _windows(rng, wide, height), _windows(rng, deep, height)
    far, near = upright(deep, -right, 0.0, np.pi / 2), upright(0.0, left)
    walls = [
        bodies.wall(wide, height, [entry]).moved(upright(0.0, -right, 0.0, np.pi / 2)),
        bodies.wall(wide, height, ahead).moved(far),
        bodies.wall(deep, height, beside).moved(near),
        bodies.wall(deep, height, []).moved(upright(0.0, -right)),
    ]
    objects = [SceneObject("wall", join(walls).moved(pose))]
    if glazing is not None:
        objects += glazing.panes_in(ahead, pose @ far) + glazing.panes_in(beside, pose @ near)
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(2.0, deep - 1.0), rng.choice([-1, 1]) * rng.uniform(3.2, 4.2)
        round_one = rng.random() < 0.5
        body = cylinder(rng.uniform(0.2, 0.4), height) if round_one else box((*rng.uniform(0.3, 0.7, 2), height))
        objects.append(SceneObject("pillar", body.moved(pose @ upright(x, y))))
    return objects + _furniture(rng, pose @ upright(0.5 * deep, middle), (deep, wide), 7)


def _windows(rng: np.random.Generator, length: float, height: float) -> list[tuple[float, float, float, float]]:
    openings, place = [], rng.uniform(0.6, 1.6)
    while (end := place + rng.uniform(0.9, 1.8)) < length - 0.4:
        openings.append((place, end, rng.uniform(0.8, 1.0), height - rng.uniform(0.3, 0.6)))
        place = end + rng.uniform(0.5, 2.5)
    return openings


def _furniture(rng: np.random.Generator, centre: Array, size: tuple[float, float], count: int) -> list[SceneObject]:
    """Tables, shelves, boxes, people in a room of `size` (x, y) [m], off its middle where the carrier may go."""
    objects = []
    for _ in range(count):
        x, y = rng.uniform(-0.42, 0.42) * size[0], rng.choice([-1, 1]) * rng.uniform(0.27, 0.42) * size[1]
        body = (bodies.table, bodies.clutter, bodies.person)[rng.choice(3, p=(0.6, 0.3, 0.1))]
        mesh = body(rng).moved(centre @ upright(x, y, 0.0, rng.uniform(0.0, 6.3)))
        objects.append(SceneObject("furniture", mesh))
    for side in (-1, 1):
        for _ in range(int(rng.integers(1, 3))):
            facing = 0.0 if side < 0 else np.pi
            spot = upright(rng.uniform(-0.35, 0.35) * size[0], side * (0.5 * size[1] - 0.1), 0.0, facing)
            objects.append(SceneObject("furniture", bodies.shelf(rng).moved(centre @ spot)))
    return objects


def _room_row(
    rng: np.random.Generator, side: int, sizes: tuple[float, float, float], glazing: Glazing | None
) -> list[SceneObject]:
    """Rooms along one side of the corridor, each with a door to it."""
    length, corridor, height = sizes
    borders = [0.0]
    while length - borders[-1] > 9.0:
        borders.append(borders[-1] + rng.uniform(3.2, 7.0))
    borders.append(length)
    deep, doors, objects = rng.uniform(4.0, 7.0), [], []
    for a, b in pairwise(borders):
        wide = rng.uniform(0.9, 2.0)
        door = rng.uniform(a + 0.3, b - 0.3 - wide)
        doors.append((door, door + wide, 0.0, _DOOR_HEIGHT_M))
        angle = side * rng.uniform(0.6, 1.7)
        leaf = box((0.9, 0.05, _DOOR_HEIGHT_M), (0.45, 0.0, 0.0))
        objects.append(SceneObject("door", leaf.moved(upright(door, side * 0.5 * corridor, 0.0, angle))))
        pose = upright(b, side * 0.5 * corridor, 0.0, side * np.pi / 2)
        holes = [] if glazing is None else glazing.instead_of_wall([(0.0, deep)], height)
        objects += [SceneObject("wall", bodies.wall(deep, height, holes).moved(pose)), *panes(holes, pose)]
        centre = upright(0.5 * (a + b), side * (0.5 * corridor + 0.5 * deep))
        objects += _furniture(rng, centre, (b - a, deep), 3)
    at_corridor, at_yard = upright(0.0, side * 0.5 * corridor), upright(0.0, side * (0.5 * corridor + deep))
    windows = _windows(rng, length, height)
    if glazing is not None:
        ends = zip([0.0, *(door[1] for door in doors)], [*(door[0] for door in doors), length], strict=True)
        holes = glazing.instead_of_wall(list(ends), height)
        objects += panes(holes, at_corridor) + glazing.panes_in(windows, at_yard)
        doors = sorted(doors + holes)
    inner = bodies.wall(length, height, doors).moved(at_corridor)
    outer = bodies.wall(length, height, windows).moved(at_yard)
    return [*objects, SceneObject("wall", join([inner, outer]))]


def _corridor_things(rng: np.random.Generator, length: float, width: float) -> list[SceneObject]:
    """Cabinets, boxes and pilasters that narrow the corridor, never by more than the carrier leaves free."""
    objects, place = [], rng.uniform(0.5, 3.0)
    while place < length:
        side, deep = rng.choice([-1, 1]), rng.uniform(0.15, 0.55)
        body = box((rng.uniform(0.3, 1.5), deep, rng.choice([0.6, 1.0, 1.9, 2.6]) * rng.uniform(0.8, 1.0)))
        objects.append(SceneObject("cabinet", body.moved(upright(place, side * 0.5 * (width - deep)))))
        place += rng.uniform(0.8, 2.8)
    return objects


def _lamps(rng: np.random.Generator, length: float, height: float) -> Mesh:
    places = np.cumsum(rng.uniform(1.8, 4.0, int(length / 1.8)))
    places = places[places < length]
    return join(box((rng.uniform(0.3, 1.2), 0.2, 0.12), (x, rng.uniform(-0.3, 0.3), height - 0.12)) for x in places)


def _walkers(rng: np.random.Generator, track: Track, config: SceneConfig) -> list[SceneObject]:
    """People ahead and behind on the carrier's own way, at its pace and a bit beside it."""
    if config.moving_share == 0.0:
        return []
    starts = [2.5, track.length_m - 3.0, 0.6 * track.length_m][: max(1, round(4 * config.moving_share))]
    paces = [config.speed_mps * 1.1, 0.0, config.speed_mps * 1.05]
    return [SceneObject("person", bodies.person(rng).moved(upright(0.0, 0.5)), Motion(track, start, pace))
            for start, pace in zip(starts, paces, strict=False)]  # fmt: skip


def build_bare_corridor(rng: np.random.Generator, config: SceneConfig) -> Scene:
    """Straight walls, floor and ceiling, closed beyond the sensor's sight: nothing tells how far one went."""
    return _straight_corridor(rng, config, lambda _rng, _length, _size: [])


def build_furnished_corridor(rng: np.random.Generator, config: SceneConfig) -> Scene:
    """The same corridor with door frames, boxes and pillars."""
    return _straight_corridor(rng, config, _corridor_features)


_Features = Callable[[np.random.Generator, float, tuple[float, float]], list[SceneObject]]


def _straight_corridor(rng: np.random.Generator, config: SceneConfig, features: _Features) -> Scene:
    width, height = rng.uniform(2.3, 3.2), rng.uniform(2.5, 3.2)
    whole, middle = config.length_m + 2 * _CORRIDOR_END_M, 0.5 * config.length_m
    slabs = [("floor", (whole, width, 0.2), (middle, 0.0, -0.2))]
    slabs += [("ceiling", (whole, width, 0.2), (middle, 0.0, height))]
    slabs += [("wall", (whole, 0.2, height), (middle, side * (0.5 * width + 0.1), 0.0)) for side in (-1, 1)]
    slabs += [("wall", (0.2, width, height), (middle + end * 0.5 * whole, 0.0, 0.0)) for end in (-1, 1)]
    objects = [SceneObject(kind, box(size, centre)) for kind, size, centre in slabs]
    objects += features(rng, config.length_m, (width, height))
    x = np.arange(0.0, config.length_m + 5.0, 0.1)
    sway = 0.12 * np.sin(2 * np.pi * x / rng.uniform(8.0, 14.0))
    return Scene("corridor", tuple(objects), Track.on_ground(np.stack([x, sway], -1), _flat), _SENSOR_HEIGHT_M)


def _corridor_features(rng: np.random.Generator, length: float, size: tuple[float, float]) -> list[SceneObject]:
    (width, height), objects, place = size, [], -60.0
    while place < length + 60.0:
        side, deep = rng.choice([-1, 1]), rng.uniform(0.15, 0.5)
        kind = str(rng.choice(["door_frame", "box", "pillar"]))
        body = {
            "door_frame": join(box((0.12, 0.25, 2.1), (x, 0.0, 0.0)) for x in (-0.5, 0.5)),
            "box": box((rng.uniform(0.4, 1.4), deep, rng.uniform(0.4, 1.8))),
            "pillar": cylinder(0.5 * deep + 0.05, height),
        }[kind]
        objects.append(SceneObject(kind, body.moved(upright(place, side * (0.5 * width - 0.5 * deep)))))
        place += rng.uniform(1.0, 4.0)
    return objects
