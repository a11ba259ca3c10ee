"""Panes let most beams through, and scenes have panes only where they are asked for."""

from __future__ import annotations

import numpy as np
import pytest
from test_simulation import quiet, straight_track

from svc_ros.core.errors import ConfigError
from svc_ros.simulation import build_scene
from svc_ros.simulation.meshes import box, from_quads
from svc_ros.simulation.ray_casting import CastScan, RayCaster, cast_scan
from svc_ros.simulation.sensors import lidar_model
from svc_ros.simulation.world import GLASS, Scene, SceneConfig, SceneObject

PANE_X, WALL_X, BACK_X = 4.0, 9.0, -3.0
PANE = SceneObject(GLASS, from_quads([[(PANE_X, y, z) for y, z in ((-9, -9), (9, -9), (9, 9), (-9, 9))]]))


def room(*things: SceneObject) -> Scene:
    """A wall ahead, behind the place of the pane, and one behind the sensor."""
    walls = [SceneObject("wall", box((0.2, 60.0, 60.0), (x, 0.0, -30.0))) for x in (WALL_X + 0.1, BACK_X - 0.1)]
    return Scene("room", (*walls, *things), straight_track(), 0.0)


def through_pane(seed: int = 0, *things: SceneObject) -> tuple[CastScan, np.ndarray]:
    """The scan, and x of the points that were seen in the pane's directions."""
    cast = cast_scan(room(*things), np.eye(4), quiet(lidar_model("OS0-64")), np.random.default_rng(seed))
    level = np.abs(cast.points[:, 1:]).max(axis=1) < 0.9 * cast.points[:, 0] * 9.0 / PANE_X
    return cast, cast.points[level & (cast.points[:, 0] > 0.0), 0]


def test_most_beams_go_through_some_return_and_some_are_mirrored() -> None:
    cast, x = through_pane(0, PANE)
    behind, at_pane = np.abs(x - WALL_X) < 0.01, np.abs(x - PANE_X) < 0.01
    ghost = np.abs(x - (2 * PANE_X - BACK_X)) < 0.01  # the mirror image of the wall behind the sensor
    assert (behind | at_pane | ghost).all()
    assert behind.mean() > 0.7
    assert 0.02 < at_pane.mean() < 0.15
    assert 0.03 < ghost.mean() < 0.25
    assert set(cast.object_idx) == {0, 1, 2}


def test_a_pane_met_head_on_returns() -> None:
    cast, _ = through_pane(0, PANE)
    head_on = np.linalg.norm(cast.points[:, 1:], axis=1) < 0.05 * cast.points[:, 0]
    assert (np.abs(cast.points[head_on, 0] - PANE_X) < 0.01).mean() > 0.3


def test_without_a_pane_all_see_the_wall_and_the_numbers_stay() -> None:
    with_pane, _ = through_pane(0, PANE)
    without, x = through_pane(0)
    assert x == pytest.approx(WALL_X, abs=1e-3)
    back = [cast.points[cast.points[:, 0] < 0.0] for cast in (with_pane, without)]
    assert np.array_equal(*back)


def test_panes_follow_from_the_seed() -> None:
    first, again, other = (through_pane(seed, PANE)[0].points for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_panes_are_added_to_the_same_scene(name: str) -> None:
    plain, glazed, again = (
        build_scene(name, np.random.default_rng(5), SceneConfig(20.0, 0.5, glass_share=share))
        for share in (0.0, 0.6, 0.6)
    )
    assert GLASS not in plain.kinds()
    assert glazed.kinds().count(GLASS) > 5
    assert [kind for kind in glazed.kinds() if kind != GLASS] == plain.kinds()
    assert np.array_equal(glazed.track.points, plain.track.points)
    for a, b in zip(glazed.objects, again.objects, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices)
    cars = [[o.mesh.vertices for o in scene.objects if o.kind in ("car", "furniture")] for scene in (plain, glazed)]
    assert all(np.array_equal(*pair) for pair in zip(*cars, strict=True))


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_panes_of_a_scene_are_seen_and_seen_through(name: str) -> None:
    ranges = []
    for share in (0.0, 0.8):
        scene = build_scene(name, np.random.default_rng(5), SceneConfig(20.0, 0.0, glass_share=share))
        pose = scene.track.pose(10.0)
        pose[2, 3] += scene.sensor_height_m
        sensor = quiet(lidar_model("OS1-64"))
        cast = RayCaster(scene).cast(pose, sensor, np.random.default_rng(0))
        at_pane = np.isin(cast.object_idx, [i for i, kind in enumerate(scene.kinds()) if kind == GLASS])
        assert at_pane.any() == (share > 0.0)
        assert at_pane.mean() < 0.05
        full = np.full(len(sensor.directions()), np.nan)
        rays = sensor.directions()
        index = np.abs(np.arctan2(-cast.points[:, 1], cast.points[:, 0]) % (2 * np.pi)) / (2 * np.pi) * sensor.columns
        full[(np.round(index).astype(int) % sensor.columns) * sensor.num_beams + cast.beam_idx] = np.linalg.norm(
            cast.points, axis=1
        )
        assert len(rays) == len(full)
        ranges.append(full)
    farther = ranges[1] > ranges[0] + 0.5
    nearer = ranges[1] < ranges[0] - 0.5
    assert farther.sum() > 3 * nearer.sum()
    assert farther.sum() > 100


def test_an_impossible_share_is_refused() -> None:
    with pytest.raises(ConfigError, match="glass_share"):
        SceneConfig(glass_share=1.5)
