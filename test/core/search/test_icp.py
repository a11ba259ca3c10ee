"""ICP ends where the surfaces meet: against a plain twin, against small_gicp, and on a real pair."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from assertions import assert_same_bits, assert_same_pose
from scan_cases import T_ROOM, random_scan, real_pair, room_config, room_scans
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.kernels import icp as icp_kernels
from svc_ros.core.registration import prepare
from svc_ros.core.scans.neighbours import NearestGrid
from svc_ros.core.search import icp


def pose(yaw_deg: float = 0.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    return se3.make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), (x, y, 0.0))


def align(T, source, target, radius, rounds) -> tuple[np.ndarray, int]:
    """The kernel's pose (4, 4) and rounds, on all points of two prepared scans, or on the source points given."""
    points = getattr(source, "points", source)
    moved, tables = np.array(T), NearestGrid.build(target.points, radius).tables
    return moved, icp_kernels.align(moved, points, target.normals, target.points, radius, tables, rounds)


@pytest.fixture(scope="module")
def room():
    config = room_config()
    return (*(prepare(scan, config) for scan in room_scans()), config)


@pytest.mark.parametrize("start", [pose(), pose(3.0, 0.2, 0.1), pose(-4.0, -0.1, 0.3)])
def test_icp_ends_where_the_walls_meet(room, start):
    source, target, config = room
    refined = icp.refine_by_icp(T_ROOM @ start, source, target, config, 3000)
    assert_same_pose(refined, T_ROOM, 0.3, 0.03)


@pytest.mark.parametrize("rounds", [4])
def test_rounds_equal_those_of_a_plain_twin(room, rounds):
    source, target, _ = room
    start = T_ROOM @ pose(2.0, 0.1, -0.1)
    points = source.points[::4]  # the twin looks at every target point for each of them
    expected = reference.point_to_plane_icp(start, points, (target.points, target.normals), 0.6, rounds)
    assert_same_pose(align(start, points, target, 0.6, rounds)[0], expected, 1e-3, 1e-4)


def test_icp_ends_where_small_gicp_ends(room):
    small_gicp = pytest.importorskip("small_gicp", reason="small-gicp is not installed")
    source, target, _ = room
    cloud, tree = small_gicp.PointCloud(target.points), small_gicp.KdTree(target.points)
    small_gicp.estimate_normals(cloud, tree, num_neighbors=10)
    theirs = small_gicp.align(
        cloud, small_gicp.PointCloud(source.points), tree, T_ROOM @ pose(2.0), registration_type="PLANE_ICP",
        max_correspondence_distance=0.6, max_iterations=30,
    )  # fmt: skip
    ours, _ = align(T_ROOM @ pose(2.0), source, target, 0.6, 30)
    assert_same_pose(ours, theirs.T_target_source, 0.1, 0.01)  # their normals are of ten neighbours


def test_icp_on_a_real_pair_goes_back_to_the_reference(shared_data):
    *scans, T, config = real_pair(shared_data, "hdl64_kitti_a")
    source, target = (prepare(scan, config) for scan in scans)
    refined = icp.refine_by_icp(T @ pose(1.0, 0.3, -0.2), source, target, config, 5000)
    assert_same_pose(refined, T, 0.2, 0.06)


def test_icp_there_and_back_are_inverse(room):
    source, target, config = room
    there = icp.refine_by_icp(T_ROOM, source, target, config, 10_000)
    back = icp.refine_by_icp(se3.invert(T_ROOM), target, source, config, 10_000)
    assert_same_pose(there @ back, np.eye(4), 0.3, 0.03)


def test_icp_gives_the_same_bits_again(room):
    source, target, config = room
    runs = [icp.refine_by_icp(T_ROOM @ pose(2.0), source, target, config, 1000) for _ in range(2)]
    assert_same_bits(runs[0], runs[1])


def test_a_pose_far_from_everything_stays(room):
    source, target, _ = room
    far = pose(0.0, 500.0)
    moved, rounds = align(far, source, target, 0.6, 10)
    assert_same_bits(moved, far)
    assert rounds == 1


def test_one_plane_leaves_what_it_does_not_hold():
    """On a floor alone nothing but height, roll and pitch is moved."""
    rng = np.random.default_rng(4)
    floor = random_scan(2000, 1)
    floor.points.flags.writeable = floor.normals.flags.writeable = True
    floor.points[:] = np.column_stack([rng.uniform(-5, 5, (2000, 2)), np.zeros(2000)])
    floor.normals[:] = (0.0, 0.0, 1.0)
    moved, _ = align(pose(10.0, 0.3, 0.2) @ se3.make_pose(np.eye(3), (0, 0, 0.1)), floor, floor, 0.5, 20)
    assert_same_pose(moved, pose(10.0, 0.3, 0.2), 1e-3, 1e-3)
