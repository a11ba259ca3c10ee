"""From raw points to thinned points with normals: the same bits in any order, and every normal faces the sensor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import reference_surfaces
from assertions import assert_same_bits
from mini_data import POSES, scan_room

from svc_ros.core.config import PreprocessConfig
from svc_ros.core.errors import ConfigError, TooFewPointsError
from svc_ros.core.kernels import raw_scan
from svc_ros.core.range_image import build_range_image
from svc_ros.core.scan import Scan
from svc_ros.core.scans import preprocess as stage

CONFIG = PreprocessConfig(voxel_size_m=0.2, min_range_m=0.3, max_range_m=30.0)
RNG = np.random.default_rng(3)
ROOM = scan_room(POSES[0])


def level_floor(height: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(-5, 5, 0.2), np.arange(-5, 5, 0.2))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])


def test_order_of_points_does_not_matter_to_a_single_bit():
    reference = stage.preprocess(Scan(ROOM), CONFIG)
    for _ in range(3):
        shuffled = stage.preprocess(Scan(RNG.permutation(ROOM)), CONFIG)
        assert_same_bits(shuffled.points, reference.points)
        assert_same_bits(shuffled.normals, reference.normals)
        assert_same_bits(shuffled.range_image.near, reference.range_image.near)
        assert_same_bits(shuffled.range_image.far, reference.range_image.far)


def test_the_range_image_is_of_all_raw_points_but_the_carriers():
    """Also of those beyond the largest range, through which the sensor looked, and before the voxel grid."""
    origin = np.array([1.0, -2.0, 0.5])
    scan = Scan(ROOM + origin, sensor_origin=origin)
    near = stage.preprocess(scan, dataclasses.replace(CONFIG, max_range_m=3.0))
    whole = stage.preprocess(scan, CONFIG)
    assert len(near) < len(whole)
    for prepared in (near, whole):
        image = build_range_image(scan.points, origin, CONFIG.min_range_m, prepared.beam_spacing_deg)
        assert_same_bits(prepared.range_image.near, image.near)
        assert_same_bits(prepared.range_image.far, image.far)
        assert prepared.range_image.far.max() == pytest.approx(np.linalg.norm(ROOM, axis=1).max())
    blind = stage.preprocess(scan, dataclasses.replace(CONFIG, min_range_m=2.5))
    held = blind.range_image.near > 0
    assert blind.range_image.near[held].min() > 2.5 > whole.range_image.near[whole.range_image.near > 0].min()


def test_input_is_left_alone():
    points = ROOM.copy()
    stage.preprocess(Scan(points), CONFIG)
    assert_same_bits(points, ROOM)


def test_range_is_counted_from_the_sensor():
    origin = np.array([100.0, 0, 0])
    points = origin + np.array([[0.2, 0, 0], [0.31, 0, 0], [0, 5, 0], [0, 0, 30], [0, 0, 30.1]])
    kept = stage.crop_range(points, origin, CONFIG)
    np.testing.assert_array_equal(kept, points[1:4])


def test_points_at_the_sensor_itself_have_no_direction_and_go():
    config = dataclasses.replace(CONFIG, min_range_m=0.0)
    np.testing.assert_array_equal(
        stage.crop_range(np.array([[0.0, 0, 0], [0, 0, 1]]), np.zeros(3), config), [[0, 0, 1]]
    )


def test_one_point_a_voxel_and_it_is_the_mean():
    corner = np.array([[-10.0, -10, -10]])  # the grid starts half a voxel below it
    cluster = np.array([[0.33, 0.31, 0.35], [0.37, 0.33, 0.31], [0.32, 0.38, 0.39]])
    thinned = stage.thin_on_voxel_grid(np.concatenate([corner, cluster, cluster + 5.0]), 0.2)
    expected = np.stack([corner[0], cluster.mean(0), cluster.mean(0) + 5.0])
    np.testing.assert_allclose(thinned, expected, atol=1e-9)


def test_the_table_of_cells_grows_with_them():
    """More cells than any first table has, each met twice, far apart in the cloud."""
    x, y = np.meshgrid(np.arange(150), np.arange(150))
    cells = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]) + 0.5
    thinned = stage.thin_on_voxel_grid(np.vstack([cells - 0.2, RNG.permutation(cells) + 0.2]), 1.0)
    np.testing.assert_allclose(thinned[np.lexsort(thinned.T)], cells[np.lexsort(cells.T)], atol=1e-8)


@pytest.mark.parametrize("voxel", [0.05, 0.3, 2.0])
def test_thinning_equals_a_dictionary_of_cells(voxel):
    points = RNG.normal(size=(3000, 3)) * 4 - 7
    cells: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in points:
        cell = np.floor((point - (points.min(0) - 0.5 * voxel)) / voxel)
        cells.setdefault(tuple(cell.astype(int)), []).append(point)
    expected = np.array([np.mean(inside, axis=0) for inside in cells.values()])
    found = stage.thin_on_voxel_grid(points, voxel)
    np.testing.assert_allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-8)


def test_points_come_column_by_column_upwards():
    thinned = stage.thin_on_voxel_grid(RNG.normal(size=(3000, 3)) * 4 - 7, 0.3)
    columns = np.floor((thinned[:, :2] - thinned.min(0)[:2]) / (stage._COLUMN_VOXELS * 0.3)).astype(int)
    np.testing.assert_array_equal(np.lexsort((thinned[:, 2], columns[:, 1], columns[:, 0])), np.arange(len(thinned)))


def test_points_at_one_height_are_sorted_all_the_same():
    floor = np.column_stack([RNG.uniform(-5, 5, (500, 2)), np.zeros(500)])
    thinned = stage.thin_on_voxel_grid(floor, 0.3)
    assert len(thinned) > 200
    assert_same_bits(stage.thin_on_voxel_grid(RNG.permutation(floor), 0.3), thinned)


def test_nothing_in_nothing_out():
    assert stage.thin_on_voxel_grid(np.zeros((0, 3)), 0.3).shape == (0, 3)


def test_voxels_that_cannot_be_counted_are_refused():
    with pytest.raises(ConfigError, match="voxel_size_m"):
        stage.thin_on_voxel_grid(np.array([[0.0, 0, 0], [1e6, 1e6, 1e6]]), 1e-3)


@pytest.mark.parametrize("origin", [np.zeros(3), np.array([0.5, -0.5, 0.4])])
def test_normals_are_unit_and_face_the_sensor(origin):
    prepared = stage.preprocess(Scan(ROOM, sensor_origin=origin), CONFIG)
    np.testing.assert_allclose(np.linalg.norm(prepared.normals, axis=1), 1, atol=1e-9)
    assert ((prepared.normals * (origin - prepared.points)).sum(1) >= 0).all()


@pytest.mark.parametrize("most", [4, 30])
def test_normals_are_those_of_all_neighbours_by_brute_force(most):
    config = dataclasses.replace(CONFIG, normal_max_neighbours=most, normal_radius_voxels=3.0)
    points = stage.thin_on_voxel_grid(ROOM[::7], 0.2) + RNG.normal(size=3)
    expected = reference_surfaces.fitted_normals(points, config.normal_radius_m, most)
    found = stage.estimate_normals(points, np.zeros(3), config)
    known = np.isfinite(expected[:, 0])
    assert known.sum() > 500
    np.testing.assert_allclose(np.abs((found * expected).sum(1))[known], 1, atol=1e-9)
    facing = -points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(found[~known], facing[~known], atol=1e-12)


def test_normals_equal_those_of_open3d():
    o3d = pytest.importorskip("open3d")
    points = stage.thin_on_voxel_grid(ROOM, 0.2)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(points.copy()))
    cloud.estimate_normals(max_nn=CONFIG.normal_max_neighbours, radius=CONFIG.normal_radius_m)
    cosine = np.abs((cloud.point.normals.numpy() * stage.estimate_normals(points, np.zeros(3), CONFIG)).sum(1))
    assert np.quantile(cosine, 0.01) > 1 - 1e-9  # the rest: too few neighbours, no plane


def test_points_in_a_line_get_a_normal_across_it():
    along = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    normals = stage.estimate_normals(np.arange(1, 60)[:, None] * 0.1 * along + (0, 5, 0), np.zeros(3), CONFIG)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(normals @ along, 0, atol=1e-6)


def test_normals_of_a_room_are_those_of_its_walls():
    prepared = stage.preprocess(Scan(ROOM), CONFIG)
    on_west_wall = prepared.points[:, 0] < -5.95
    towards_room = prepared.normals[on_west_wall] @ (1.0, 0.0, 0.0)
    assert on_west_wall.sum() > 50
    assert np.median(towards_room) > 0.99


@pytest.mark.parametrize(("height", "up"), [(-1.5, 1.0), (2.5, -1.0)])
def test_a_perfectly_level_floor_or_ceiling_keeps_its_normal(height, up):
    normals = stage.estimate_normals(level_floor(height), np.zeros(3), CONFIG)
    np.testing.assert_allclose(normals, np.tile((0, 0, up), (len(normals), 1)), atol=1e-6)


def test_a_point_without_a_plane_faces_the_sensor():
    lonely = np.array([[3.0, 4.0, 0.0], [20.0, 0.0, 0.0], [20.1, 0.0, 0.0]])
    normals = stage.estimate_normals(np.concatenate([level_floor(-1.5), lonely]), np.zeros(3), CONFIG)
    np.testing.assert_allclose(normals[-3:], [[-0.6, -0.8, 0], [-1, 0, 0], [-1, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((500, 3)), ROOM * 100])
def test_too_few_points_say_how_many_were_left_and_why(points):
    with pytest.raises(TooFewPointsError, match=r"expected at least 100 points.*0.3-30 m.*found \d+ \(of \d+ raw"):
        stage.preprocess(Scan(points, frame_id="lidar"), CONFIG)


def test_stamp_frame_and_origin_travel_along():
    prepared = stage.preprocess(Scan(ROOM, 42, "lidar", np.array([0.1, 0, 0])), CONFIG)
    assert (prepared.stamp_ns, prepared.frame_id, prepared.voxel_size_m) == (42, "lidar", 0.2)
    np.testing.assert_array_equal(prepared.sensor_origin, (0.1, 0, 0))


@pytest.mark.parametrize(("num_beams", "spacing"), [(16, 2.0), (64, 0.4)])
def test_beam_spacing_is_that_of_the_sensor(num_beams, spacing):
    elevation = (np.arange(num_beams) - num_beams / 2) * spacing
    rays, beams = (a.ravel() for a in np.meshgrid(np.radians(np.arange(0, 360, 0.2)), np.radians(elevation)))
    directions = np.column_stack([np.cos(beams) * np.cos(rays), np.cos(beams) * np.sin(rays), np.sin(beams)])
    points = directions * RNG.uniform(2, 20, (len(directions), 1))
    for origin in (np.zeros(3), np.array([4.0, -2.0, 1.0])):
        found = stage.estimate_beam_spacing_deg(points + origin, origin)
        assert found == pytest.approx(spacing, rel=0.02)
        assert stage.estimate_beam_spacing_deg(RNG.permutation(points) + origin, origin) == found


@pytest.mark.parametrize("every", [6, 30])
def test_elevations_of_some_sectors_equal_those_by_angles_alone(every):
    """Beside the borders of sectors and on those of quadrants, too: there the table must not spare the arc tangent."""
    borders = np.arange(-180.0, 180.0, 0.5)
    azimuth = np.radians(np.concatenate([borders + 1e-9, borders + 0.5 - 1e-9, RNG.uniform(-180, 180, 20_000)]))
    points = np.column_stack([np.cos(azimuth), np.sin(azimuth), RNG.uniform(-1, 1, len(azimuth))])
    points = np.vstack([points, [[0.0, 0, 1], [1, 0, 0], [-1, 0, 0], [-1, -0.0, 0], [0, 1, 0], [0, -1, 0]]])
    x, y, z = points.T
    sector = np.floor(np.degrees(np.arctan2(y, x)) / 0.5)
    wanted = (1024.0 * sector + np.degrees(np.arctan2(z, np.sqrt(x * x + y * y))))[sector % every == 0]
    keys = np.empty(len(points))
    num = raw_scan.fill_elevations(points, np.zeros(3), 0.5, every, stage._maybe_in_sector(every), keys)
    np.testing.assert_allclose(keys[:num], wanted, rtol=1e-12)


def test_a_cloud_of_millions_shows_its_spacing_in_fewer_sectors(monkeypatch):
    beams, rays = np.meshgrid(np.radians(np.arange(-15.0, 16.0, 2.0)), np.radians(np.arange(0, 360, 0.1)))
    ring = np.column_stack([(np.cos(beams) * np.cos(rays)).ravel(), (np.cos(beams) * np.sin(rays)).ravel(),
                            np.sin(beams).ravel()])  # fmt: skip
    whole = stage.estimate_beam_spacing_deg(ring, np.zeros(3))
    for enough in (10_000, 100):
        monkeypatch.setattr(stage, "_ENOUGH_POINTS", enough)
        assert stage.estimate_beam_spacing_deg(ring, np.zeros(3)) == pytest.approx(whole, rel=1e-6)


def test_one_ring_has_no_beam_spacing():
    azimuth = np.radians(np.arange(0, 360, 0.2))
    ring = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    assert stage.estimate_beam_spacing_deg(ring, np.zeros(3)) == 0.0
    assert stage.estimate_beam_spacing_deg(np.zeros((0, 3)), np.zeros(3)) == 0.0
