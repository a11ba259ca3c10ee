"""Sensors that look ahead only, and a tripod scanner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_simulation import box_room, straight_track

from svc_ros.core import se3
from svc_ros.core.errors import ConfigError
from svc_ros.simulation import SENSORS, DriveConfig, drive_scans, lidar_model, sensor_model
from svc_ros.simulation.effects import Effects
from svc_ros.simulation.meshes import box, upright
from svc_ros.simulation.narrow_sensors import DepthCameraModel, RosetteModel
from svc_ros.simulation.ray_casting import cast_scan
from svc_ros.simulation.sensor_model import T_BODY_OPTICAL, SensorModel
from svc_ros.simulation.world import Scene, SceneObject


def angles_deg(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth and elevation of rays (x ahead, z up)."""
    return np.degrees(np.arctan2(rays[:, 1], rays[:, 0])), np.degrees(np.arcsin(rays[:, 2]))


@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_tells_unit_rays_and_their_times(name: str) -> None:
    model = sensor_model(name)
    rays, times = model.directions(), model.firing_times_s()
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    assert times.shape == (len(rays),)
    assert times[0] == 0.0
    assert (np.diff(times) >= 0.0).all()
    assert len(rays) % model.num_beams == 0


def test_the_solid_state_sensor_sees_a_field_of_120_by_25_deg() -> None:
    azimuth, elevation = angles_deg(sensor_model("RS-M1").directions())
    assert [azimuth.min(), azimuth.max()] == pytest.approx([-60.0, 60.0], abs=0.1)
    assert [elevation.min(), elevation.max()] == pytest.approx([-12.5, 12.5], abs=0.1)


def test_the_rosette_fills_a_round_field_of_38_deg_and_does_not_repeat() -> None:
    model = sensor_model("MID-40")
    assert isinstance(model, RosetteModel)
    rays = model.directions()
    off_axis = np.degrees(np.arccos(rays[:, 0]))
    assert 100_000 <= len(rays) <= 240_000
    assert off_axis.max() == pytest.approx(19.2, abs=0.1)
    azimuth, elevation = angles_deg(rays)
    shares = []
    for count in (10_000, len(rays)):
        cells = np.histogram2d(azimuth[:count], elevation[:count], bins=90, range=[[-19.2, 19.2]] * 2)[0] > 0
        shares.append(cells.mean() / (np.pi / 4))
    assert shares[0] < 0.8 < 0.97 < shares[1]  # the longer it looks, the fewer gaps
    later = replace(model, start_s=7.3).directions()
    assert not np.allclose(later[:1000], rays[:1000], atol=1e-3)


def test_the_depth_camera_sees_a_pinhole_image_in_its_optical_frame() -> None:
    model = sensor_model("XTION")
    assert isinstance(model, DepthCameraModel)
    rays = model.directions().reshape(model.height, model.width, 3)
    slope = rays[..., :2] / rays[..., 2:]
    assert np.degrees(np.arctan(slope[..., 0])).max() == pytest.approx(29.0, abs=0.2)
    assert np.degrees(np.arctan(slope[..., 1])).max() == pytest.approx(22.5, abs=0.2)
    assert (np.diff(slope[0, :, 0]) > 0).all()  # x to the right
    assert (np.diff(slope[:, 0, 1]) > 0).all()  # y down
    body = se3.rotate(T_BODY_OPTICAL, np.eye(3))
    assert body.tolist() == [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]


def test_a_depth_camera_measures_depth_whose_noise_and_limits_are_of_depth() -> None:
    sigmas, model = {}, replace(sensor_model("XTION"), dropout_ratio=0.0)
    for depth in (1.0, 3.0, 6.0):
        wall = SceneObject("wall", box((0.2, 100.0, 100.0), (depth + 0.1, 0.0, -50.0)))
        scene = Scene("wall", (wall,), straight_track(), 0.0)
        z = cast_scan(scene, T_BODY_OPTICAL, model, np.random.default_rng(0)).points[:, 2]
        assert np.mean(z) == pytest.approx(depth, rel=0.01)
        sigmas[depth] = np.std(z)
        steps = 1.0 / (z.astype(np.float64) * model.effects.inverse_depth_step)
        assert steps == pytest.approx(np.round(steps), abs=1e-3)
    assert sigmas[6.0] > 3.0 * sigmas[3.0] > 15.0 * sigmas[1.0]
    far = cast_scan(box_room(), T_BODY_OPTICAL, replace(model, max_range_m=30.0), np.random.default_rng(0))
    assert far.points[:, 2].max() > 15.0
    near = cast_scan(box_room(), T_BODY_OPTICAL, model, np.random.default_rng(0))
    assert len(near) == 0 or near.points[:, 2].max() <= 8.0


def test_the_tripod_scanner_sees_all_but_a_cone_below() -> None:
    azimuth, elevation = angles_deg(sensor_model("UTM-30LX").directions())
    assert [elevation.min(), elevation.max()] == pytest.approx([-80.0, 90.0])
    assert np.ptp(azimuth) > 359.0
    assert len(azimuth) > 300_000


@pytest.mark.parametrize("name", ["RS-M1", "MID-40", "XTION", "UTM-30LX"])
def test_points_lie_on_what_was_met_and_follow_from_the_seed(name: str) -> None:
    model: SensorModel = replace(sensor_model(name), effects=Effects(), range_noise_m=0.0, max_range_m=60.0)
    pose = upright(3.0, -2.0, 1.0, 0.7) @ (T_BODY_OPTICAL if model.is_optical else np.eye(4))
    cast, again = (cast_scan(box_room(), pose, model, np.random.default_rng(4)) for _ in range(2))
    world = se3.apply(pose, cast.points)
    assert np.abs(np.array([20.0, 10.0, 5.0]) - np.abs(world)).min(1).max() < 1e-3
    assert len(cast) > 0.9 * len(model.directions())
    assert np.array_equal(cast.points, again.points)


def test_a_camera_rides_along_looking_ahead() -> None:
    (scan,) = drive_scans(DriveConfig("indoor", "XTION", 1, seed=3))
    mount = se3.invert(scan.T_map_base) @ scan.T_map_lidar
    ahead, down = mount[:3, 2], mount[:3, 1]
    assert ahead[0] > 0.99
    assert down[2] < -0.99
    assert len(scan.cast) > 10_000


def test_a_beam_table_is_asked_of_lidars_that_have_one() -> None:
    assert sensor_model("mid_40") is SENSORS["MID-40"]
    with pytest.raises(ConfigError, match="MID-40: expected a LiDAR with a beam table"):
        lidar_model("MID-40")


@pytest.mark.parametrize(
    ("name", "change"),
    [("RS-M1", {"rows": 0}), ("RS-M1", {"field_of_view_deg": (400.0, 25.0)}), ("MID-40", {"num_points": 0}),
     ("MID-40", {"max_range_m": 0.1}), ("XTION", {"field_of_view_deg": (58.0, 180.0)}), ("XTION", {"width": 0})],
)  # fmt: skip
def test_impossible_sensors_are_refused(name: str, change: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=name):
        replace(sensor_model(name), **change)
