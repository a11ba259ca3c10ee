from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from synthetic import room_pair, street_pair, unrelated_pair

from svc_ros.core import se3
from svc_ros.core.errors import ConfigError, InputError
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import read_tum
from svc_ros.simulation.drive import DriveConfig, drive_scans, simulate_drive
from svc_ros.simulation.meshes import box, cylinder, relief, upright
from svc_ros.simulation.ray_casting import RayCaster, cast_scan
from svc_ros.simulation.scenes import SCENES, build_scene
from svc_ros.simulation.sensors import SENSORS, LidarModel, lidar_model
from svc_ros.simulation.world import Motion, Scene, SceneConfig, SceneObject, Track

FAST = SceneConfig(length_m=20.0, moving_share=0.5)


def straight_track(length_m: float = 100.0) -> Track:
    x = np.arange(0.0, length_m + 0.5, 0.5)
    return Track.on_ground(np.stack([x, 0.0 * x], -1), lambda x, y: np.zeros_like(x))


def box_room(*others: SceneObject) -> Scene:
    """The inside of a box 40 x 20 x 10 m round the origin, first of the objects."""
    return Scene(
        "box", (SceneObject("wall", box((40.0, 20.0, 10.0), (0.0, 0.0, -5.0))), *others), straight_track(), 0.0
    )


def quiet(sensor: LidarModel) -> LidarModel:
    return replace(sensor, range_noise_m=0.0, dropout_ratio=0.0)


# Sensors


@pytest.mark.parametrize(
    ("name", "beams", "top", "bottom"),
    [("VLP-16", 16, 15, -15), ("HDL-32E", 32, 10.67, -30.67), ("HDL-64E", 64, 2.0, -24.33), ("OS1-64", 64, 22.5, -22.5),
     ("OS0-64", 64, 45, -45), ("OS1-128", 128, 22.5, -22.5)],
)  # fmt: skip
def test_beam_tables_of_real_sensors(name: str, beams: int, top: float, bottom: float) -> None:
    model = lidar_model(name)
    assert model.num_beams == beams
    assert model.elevations_deg[[0, -1]] == pytest.approx([top, bottom], abs=0.01)
    assert (np.diff(model.elevations_deg) < 0).all()


def test_hdl64_has_a_fine_upper_and_a_coarse_lower_block() -> None:
    steps = -np.diff(lidar_model("HDL-64E").elevations_deg)
    assert steps[:31] == pytest.approx(1 / 3)
    assert steps[31:] == pytest.approx(0.5)


def test_directions_are_unit_and_carry_the_beam_angles() -> None:
    model = lidar_model("VLP-16")
    rays = model.directions().reshape(model.columns, model.num_beams, 3)
    assert np.linalg.norm(rays, axis=-1) == pytest.approx(1.0)
    assert np.degrees(np.arcsin(rays[37, :, 2])) == pytest.approx(model.elevations_deg)
    assert rays[0, :, 1] == pytest.approx(0.0)


def test_sensor_names_forgive_case_and_underscore_and_suggest_the_nearest() -> None:
    assert lidar_model("os1_64") is SENSORS["OS1-64"]
    with pytest.raises(ConfigError, match="did you mean 'VLP-16'"):
        lidar_model("vlp-61")


@pytest.mark.parametrize(
    "change", [{"dropout_ratio": 1.0}, {"max_range_m": 0.1}, {"range_noise_m": -1.0}, {"columns": 0}]
)
def test_impossible_sensors_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="VLP-16"):
        replace(lidar_model("VLP-16"), **change)


# Bodies


def test_relief_sets_cells_back_and_closes_the_steps() -> None:
    mesh = relief([0, 1, 2, 3], [0, 1, 2], [[0, 0], [0.5, 0], [0, 0]])
    assert set(np.round(mesh.vertices[:, 1], 6)) == {0.0, -0.5}
    corners = mesh.vertices[mesh.triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area.sum() == pytest.approx(6.0 + 3 * 0.5)  # the fronts, two reveals and the lintel


def test_boxes_and_cylinders_stand_on_their_ground() -> None:
    assert box((2, 4, 6)).vertices.min(0) == pytest.approx([-1, -2, 0])
    assert cylinder(0.5, 3.0).vertices.max(0) == pytest.approx([0.5, 0.5, 3.0])
    assert box((2, 2, 2)).moved(upright(5.0, 0.0, 1.0)).vertices.mean(0) == pytest.approx([5.0, 0.0, 2.0])


# Ray casting


def test_points_lie_on_the_surfaces_they_come_from() -> None:
    pose = upright(3.0, -2.0, 1.0, 0.7)
    cast = cast_scan(box_room(), pose, quiet(lidar_model("OS0-64")), np.random.default_rng(0))
    world = se3.apply(pose, cast.points)
    to_walls = np.abs(np.array([20.0, 10.0, 5.0]) - np.abs(world)).min(1)
    assert len(cast) > 50_000
    assert to_walls.max() < 1e-3
    assert cast.beam_idx.max() == 63
    elevation = np.degrees(np.arcsin(cast.points[:, 2] / np.linalg.norm(cast.points, axis=1)))
    assert elevation == pytest.approx(lidar_model("OS0-64").elevations_deg[cast.beam_idx], abs=1e-3)


def test_range_noise_and_dropouts_have_their_size() -> None:
    sensor = replace(lidar_model("OS0-64"), range_noise_m=0.05, dropout_ratio=0.2)
    clean = cast_scan(box_room(), np.eye(4), quiet(sensor), np.random.default_rng(1))
    noisy = cast_scan(box_room(), np.eye(4), sensor, np.random.default_rng(1))
    assert len(noisy) / len(clean) == pytest.approx(0.8, abs=0.01)
    near_wall = np.abs(noisy.points[:, 2]) < 4.0
    head_on = near_wall & (np.abs(noisy.points[:, 0]) < 1.0)
    assert np.std(np.abs(noisy.points[head_on, 1])) == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize("scene", SCENES)
def test_ranges_stay_within_the_sensor_limits(scene: str) -> None:
    world = build_scene(scene, np.random.default_rng(3), FAST)
    sensor = replace(lidar_model("VLP-16"), min_range_m=2.0, max_range_m=15.0)
    pose = world.track.pose(5.0) @ upright(0.0, 0.0, world.sensor_height_m)
    ranges = np.linalg.norm(cast_scan(world, pose, sensor, np.random.default_rng(0)).points, axis=1)
    assert len(ranges) > 1000
    assert ranges.min() >= 2.0 - 1e-5
    assert ranges.max() <= 15.0 + 1e-5
    assert ranges.max() > 10.0


def test_grazing_and_dark_surfaces_are_lost_before_bright_walls() -> None:
    ground = SceneObject("ground", box((200.0, 200.0, 0.1), (0.0, 0.0, -1.9)))
    wall = SceneObject("wall", box((0.1, 200.0, 20.0), (60.0, 0.0, -1.8)))
    scene = Scene("field", (ground, wall), straight_track(), 1.8)
    cast = cast_scan(scene, np.eye(4), lidar_model("HDL-64E"), np.random.default_rng(0))
    on_ground = np.linalg.norm(cast.points[cast.object_idx == 0], axis=1)
    on_wall = np.linalg.norm(cast.points[cast.object_idx == 1], axis=1)
    assert on_ground.max() < 60.0 < on_wall.max()


def test_the_moving_object_is_where_its_speed_takes_it() -> None:
    car = SceneObject("car", box((4.0, 2.0, 1.5)), Motion(straight_track(), 5.0, 4.0))
    caster = RayCaster(box_room(car))
    pose, sensor = upright(0.0, 6.0, 0.5), quiet(lidar_model("OS0-64"))
    for time_s, middle in ((0.0, 5.0), (2.0, 13.0)):
        cast = caster.cast(pose, sensor, np.random.default_rng(0), time_s)
        on_car = se3.apply(pose, cast.points[cast.object_idx == 1])
        assert on_car[:, 0].min() == pytest.approx(middle - 2.0, abs=0.3)
        assert on_car[:, 0].max() == pytest.approx(middle + 2.0, abs=0.3)


def test_an_object_that_left_or_whose_track_ended_is_not_hit() -> None:
    parked = SceneObject("car", box((4.0, 2.0, 1.5), (8.0, 0.0, 0.0)), leaves_at_s=3.0)
    caster = RayCaster(box_room(parked))
    hits = [
        (caster.cast(np.eye(4), lidar_model("OS0-64"), np.random.default_rng(0), t).object_idx == 1).sum()
        for t in (2.9, 3.0)
    ]
    assert hits[0] > 100
    assert hits[1] == 0
    assert Motion(straight_track(10.0), 5.0, 2.0).pose(3.0) is None


# Scenes


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_follows_from_its_seed_alone(name: str) -> None:
    first, again, other = (build_scene(name, np.random.default_rng(seed), FAST) for seed in (7, 7, 8))
    assert first.kinds() == again.kinds()
    for a, b in zip(first.objects, again.objects, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices)
    assert first.kinds() != other.kinds() or not np.array_equal(
        first.objects[1].mesh.vertices, other.objects[1].mesh.vertices
    )


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_without_moving_share_nothing_moves(name: str) -> None:
    still = build_scene(name, np.random.default_rng(2), replace(FAST, moving_share=0.0))
    busy = build_scene(name, np.random.default_rng(2), FAST)
    assert all(thing.is_static for thing in still.objects)
    assert any(thing.motion is not None for thing in busy.objects)


def test_the_way_bends_and_follows_the_ground() -> None:
    world = build_scene("street", np.random.default_rng(4), SceneConfig(length_m=60.0))
    poses = np.stack([world.track.pose(s) for s in range(0, 61, 5)])
    ways = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert ways == pytest.approx(5.0, abs=0.1)
    assert se3.rotation_angle_deg(poses[:, :3, :3] @ poses[0, :3, :3].T).max() > 2.0
    ground = world.objects[0].mesh.vertices
    near = ground[cKDTree(ground[:, :2]).query(poses[:, :2, 3])[1]]
    assert near[:, 2] == pytest.approx(poses[:, 2, 3], abs=0.3)
    assert (poses[:, 2, 2] > 0.98).all()


def test_a_bare_corridor_looks_the_same_everywhere_and_a_furnished_one_does_not() -> None:
    differences = {}
    for name in ("corridor", "corridor_features"):
        world, sensor = build_scene(name, np.random.default_rng(0), FAST), quiet(lidar_model("OS0-64"))
        caster = RayCaster(world)
        scans = [caster.cast(upright(x, 0.0, 1.2), sensor, np.random.default_rng(0)).points for x in (5.0, 8.0)]
        near = [points[np.abs(points[:, 0]) < 10.0] for points in scans]
        differences[name] = np.percentile(cKDTree(near[0]).query(near[1])[0], 99)
    assert differences["corridor"] < 0.05 < differences["corridor_features"]


def test_unknown_scenes_and_impossible_ones_are_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'street'"):
        build_scene("stret", np.random.default_rng(0))
    with pytest.raises(ConfigError, match="length_m"):
        SceneConfig(length_m=0.0)
    with pytest.raises(InputError, match="track"):
        straight_track(10.0).pose(11.0)


# Pairs for other tests


@pytest.mark.parametrize("make", [street_pair, room_pair])
def test_both_scans_of_a_pair_see_the_same_surfaces(make: type[street_pair]) -> None:
    source, target, T = make(1)
    distance = cKDTree(target.points).query(se3.apply(T, source.points))[0]
    identity = cKDTree(target.points).query(source.points)[0]
    assert len(source) > 20_000
    assert np.percentile(distance, 80) < 0.3
    assert np.percentile(identity, 80) > 2 * np.percentile(distance, 80)
    assert make(1)[0] is source


def test_unrelated_scans_share_no_street() -> None:
    source, target = unrelated_pair(1)
    assert target is not street_pair(1)[1]
    assert len(source) > 20_000


# Drives


SHORT = DriveConfig(sensor="VLP-16", num_scans=4, spacing_m=1.5, rate_hz=2.0, seed=5, teleport_after=1)


def test_drives_with_one_seed_are_equal_and_with_another_are_not() -> None:
    first, again, other = (list(drive_scans(replace(SHORT, num_scans=3, seed=seed))) for seed in (5, 5, 6))
    assert all(np.array_equal(a.cast.points, b.cast.points) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].cast.points[:500], other[0].cast.points[:500])


def test_walls_of_two_scans_meet_in_the_map() -> None:
    config = replace(SHORT, sensor="OS1-64", num_scans=2, teleport_after=None, moving_share=0.0)
    clouds = [se3.apply(scan.T_map_lidar, scan.cast.points) for scan in drive_scans(config)]
    assert np.median(cKDTree(clouds[0]).query(clouds[1])[0]) < 0.1


def test_the_bag_has_topics_frames_stamps_and_the_poses_of_the_reference(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    summary = simulate_drive(tmp_path, SHORT, lambda done, total: calls.append((done, total)))
    reference = read_tum(summary.reference)
    assert (summary.bag, summary.reference) == (tmp_path / "bag", tmp_path / "reference_tum.txt")
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with Bag(summary.bag) as bag:
        assert {topic.name: topic.count for topic in bag.topics} == {"/points": 4, "/tf": 4, "/tf_static": 1}
        readings, tree = list(bag.scans("/points")), bag.transforms()
    assert [r.scan.frame_id for r in readings] == ["lidar"] * 4
    assert [r.scan.stamp_ns for r in readings] == reference.stamps_ns.tolist()
    assert np.diff(reference.stamps_ns).tolist() == [500_000_000] * 3
    assert sum(len(r.scan) for r in readings) == summary.num_points
    for stamp, pose in zip(reference.stamps_ns, reference.poses, strict=True):
        assert tree.lookup("map", "lidar", int(stamp)) == pytest.approx(pose, abs=1e-6)
    assert tree.lookup("base_link", "lidar", int(reference.stamps_ns[0]))[2, 3] == pytest.approx(1.8)


def test_the_bag_holds_what_was_cast(tmp_path: Path) -> None:
    config = replace(SHORT, num_scans=1, teleport_after=None)
    with Bag(simulate_drive(tmp_path, config).bag) as bag:
        (reading,) = bag.scans("/points")
    (scan,) = drive_scans(config)
    assert np.array_equal(reading.scan.points.astype(np.float32), scan.cast.points)


def test_a_teleport_leads_to_another_place() -> None:
    scans = list(drive_scans(SHORT))
    way = np.linalg.norm(np.diff([s.T_map_lidar[:3, 3] for s in scans], axis=0), axis=1)
    assert way[[0, 2]] == pytest.approx(1.5, abs=0.1)
    assert way[1] > 500.0


def test_there_and_back_sees_places_twice_from_other_spots(tmp_path: Path) -> None:
    config = replace(SHORT, num_scans=5, teleport_after=None, there_and_back=True)
    assert [config.way_m(k) for k in range(5)] == [0.0, 1.5, 3.0, 2.25, 0.75]
    assert [replace(config, num_scans=4).way_m(k) for k in range(4)] == [0.0, 1.5, 2.25, 0.75]
    poses = [scan.T_map_base for scan in drive_scans(config)]
    assert np.linalg.norm((poses[4] - poses[0])[:3, 3]) == pytest.approx(0.75, abs=0.05)
    assert abs(np.degrees(np.arccos((np.trace(poses[4][:3, :3].T @ poses[0][:3, :3]) - 1) / 2))) < 10.0  # backs up
    assert simulate_drive(tmp_path, config).length_m == pytest.approx(1.5 + 1.5 + 0.75 + 1.5)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"scene": "indor"}, "did you mean 'indoor'"), ({"sensor": "OS1-65"}, "did you mean 'OS1-64'"),
     ({"num_scans": 0}, "num_scans >= 1"), ({"teleport_after": 3}, "teleport_after from 0 to 2"),
     ({"moving_share": 1.5}, "moving_share"), ({"rate_hz": 0.0}, "rate_hz > 0")],
)  # fmt: skip
def test_impossible_drives_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        replace(SHORT, **change)


def test_an_existing_bag_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists already"):
        simulate_drive(tmp_path, SHORT)
