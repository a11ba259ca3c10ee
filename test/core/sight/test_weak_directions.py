"""Weak directions of surfaces whose shape says which they are, and of whole registrations of built scenes."""

from __future__ import annotations

import numpy as np
import pytest
from scan_cases import T_ROOM, prepared, room_config, room_scans
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import SightViewConfig
from svc_ros.core.registration import verify
from svc_ros.core.scan import PreparedScan
from svc_ros.core.sight.observability import find_contact
from svc_ros.core.sight.placement import place
from svc_ros.core.sight.weak_directions import WeakDirection, find_weak_directions, names_of

LIMIT = 0.13
FAR = np.array([40.0, -25.0, 3.0])  # turns must not depend on where the origin is


def surface(count: int, normal: tuple[float, ...], at_m: float, seed: int, half_m: tuple[float, ...]) -> np.ndarray:
    """Points (N, 6) with normals, 1 cm rough, on a plane at `at_m` along its normal."""
    rng = np.random.default_rng(seed)
    axis = np.array(normal)
    spread = rng.uniform(-1, 1, (count, 3)) * half_m
    points = spread - np.outer(spread @ axis, axis) + at_m * axis + rng.normal(scale=0.01, size=(count, 3))
    tilted = -axis + rng.normal(scale=0.03, size=(count, 3))
    return np.hstack([points, tilted / np.linalg.norm(tilted, axis=1, keepdims=True)])


def floor() -> np.ndarray:
    return surface(3000, (0, 0, -1), 1.5, 0, (15, 15, 0))


def corridor() -> np.ndarray:
    """Along x: 3 m wide, 3 m high, 30 m long."""
    half = (15, 1.5, 1.5)
    sides = [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    return np.concatenate([surface(1000, side, 1.5, k, half) for k, side in enumerate(sides)])


def pipe() -> np.ndarray:
    """Along x, round."""
    rng = np.random.default_rng(5)
    angle, x = rng.uniform(0, 2 * np.pi, 4000), rng.uniform(-15, 15, 4000)
    across = np.stack([0 * x, np.cos(angle), np.sin(angle)], 1)
    return np.hstack([2.0 * across + np.outer(x, (1, 0, 0)), -across])


def tower() -> np.ndarray:
    """A round wall about z, closed by a floor."""
    upright = pipe()[:, [1, 2, 0, 4, 5, 3]]
    return np.concatenate([upright, surface(2000, (0, 0, -1), 15.0, 6, (2, 2, 0))])


def room() -> np.ndarray:
    sides = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    return np.concatenate([surface(700, side, 2.5, k, (2.5, 2.5, 2.5)) for k, side in enumerate(sides)])


def turned(rows: np.ndarray, R: np.ndarray) -> np.ndarray:
    return np.hstack([rows[:, :3] @ R.T, rows[:, 3:] @ R.T])


def weak_of(rows: np.ndarray, middle: np.ndarray = FAR, limit: float = LIMIT) -> tuple[WeakDirection, ...]:
    """Of a scan that lies on itself."""
    scan: PreparedScan = prepared(rows[:, :3] + middle, rows[:, 3:])
    config = SightViewConfig()
    return find_weak_directions(find_contact(scan, place(scan, scan, np.eye(4), config), config), limit)


@pytest.mark.parametrize(
    ("rows", "names"),
    [(floor(), "x, y, yaw"), (corridor(), "x"), (pipe(), "x, roll"), (tower(), "yaw"), (room(), "")],
    ids=["floor", "corridor", "pipe", "tower", "room"],
)
def test_what_a_shape_leaves_open_is_named(rows, names):
    for middle in (np.zeros(3), FAR):
        assert names_of(weak_of(rows, middle)) == names


def test_a_turned_corridor_gives_the_turned_vector():
    R = Rotation.from_euler("zyx", [35, 10, -5], degrees=True).as_matrix()
    (direction,) = weak_of(turned(corridor(), R))
    np.testing.assert_allclose(direction.vector, R[:, 0], atol=0.01)
    assert direction.name == "along " + " ".join(f"{v:.2f}" for v in direction.vector)
    assert direction.strength < 0.01


def test_a_slanting_floor_keeps_the_axis_that_lies_in_it():
    R = Rotation.from_euler("x", 30, degrees=True).as_matrix()
    along_x, uphill, about = weak_of(turned(floor(), R))
    assert along_x.name == "x"
    np.testing.assert_allclose(np.abs(uphill.vector), np.abs(R[:, 1]), atol=0.02)
    np.testing.assert_allclose(np.abs(about.vector), np.abs(R[:, 2]), atol=0.02)
    assert about.name.startswith("about ")


def test_strength_is_the_share_that_leads_off_the_surfaces():
    rows = np.concatenate([corridor(), surface(400, (1, 0, 0), 15.0, 9, (15, 1.5, 1.5))])
    (direction,) = weak_of(rows)
    assert direction.strength == pytest.approx(np.square(rows[:, 3:] @ direction.vector).mean(), rel=1e-6)
    assert direction.strength == pytest.approx(400 / 4400, rel=0.05)
    assert weak_of(rows, limit=0.05) == ()


def test_nothing_that_agrees_holds_nothing():
    scan = prepared(floor()[:, :3], floor()[:, 3:])
    away, config = se3.make_pose(np.eye(3), (0.0, 0.0, 50.0)), SightViewConfig()
    weak = find_weak_directions(find_contact(scan, place(scan, scan, away, config), config), LIMIT)
    assert names_of(weak) == "x, y, z, roll, pitch, yaw"
    assert {direction.strength for direction in weak} == {0.0}


@pytest.mark.parametrize("method", ["svc", "svc_paper", "sc2"])
def test_every_judged_pose_tells_them_accepted_or_not(method):
    source, target = room_scans()
    away = se3.make_pose(np.eye(3), (0.0, 0.0, 25.0))
    for T, names in ((T_ROOM, ""), (away @ T_ROOM, "x, y, z, roll, pitch, yaw")):
        result = verify(source, target, T, room_config(method=method))
        assert result.weak_directions is not None
        assert names_of(result.weak_directions) == names
