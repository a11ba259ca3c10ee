"""Agreeing surface against brute force; a covariance that is one, and grows where nothing resists."""

from __future__ import annotations

import numpy as np
import pytest
from assertions import assert_same_pose
from scan_cases import prepared, random_scan, real_pair, thin
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import CovarianceConfig, SightViewConfig
from svc_ros.core.scan import PreparedScan
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.sight.observability import SurfaceContact, find_contact, shift
from svc_ros.core.sight.placement import place

CONFIG = CovarianceConfig()
POSE = se3.make_pose(Rotation.from_euler("zyx", [20, 3, -2], degrees=True).as_matrix(), (1.0, -0.5, 0.2))
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def contact_of(points: np.ndarray, normals: np.ndarray, residuals: np.ndarray) -> SurfaceContact:
    """The contact with these constraints, summed up one by one."""
    rows = [np.concatenate((n, np.cross(p, n))) for p, n in zip(points, normals, strict=True)]
    information = sum((np.outer(row, row) for row in rows), np.zeros((6, 6)))
    return SurfaceContact(information, len(rows), float(np.square(residuals).sum()))


def contact_between(source: PreparedScan, target: PreparedScan, T, config: SightViewConfig) -> SurfaceContact:
    return find_contact(target, place(target, source, T, config), config)


def constraints_on(walls: dict[str, int], seed: int = 0, noise_m: float = 0.02) -> tuple[np.ndarray, ...]:
    """Points, normals and residuals at random on planes across each axis, half of them either side; walls: how many."""
    rng = np.random.default_rng(seed)
    points, normals = [], []
    for name, num in walls.items():
        axis, side = np.array(AXES[name]), rng.choice([-1.0, 1.0], num)
        spread = rng.uniform(-8, 8, (num, 3))
        points.append(spread - np.outer(spread @ axis, axis) + np.outer(4.0 * side, axis))
        normals.append(-np.outer(side, axis))
    count = sum(walls.values())
    return np.concatenate(points), np.concatenate(normals), rng.normal(scale=noise_m, size=count)


def contact_on(walls: dict[str, int], seed: int = 0, noise_m: float = 0.02) -> SurfaceContact:
    return contact_of(*constraints_on(walls, seed, noise_m))


def corridor(num_end: int, seed: int = 0) -> SurfaceContact:
    """Walls across y, floor and ceiling across z, and `num_end` points of something that ends the corridor along x."""
    return contact_on({"y": 1000, "z": 1000, "x": num_end}, seed)


def brute_force_contact(source, target, T, config) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """(point, plane normal, residual) of every source point, one by one."""
    found = []
    for point, normal in zip(se3.apply(T, source.points), se3.rotate(T, source.normals), strict=True):
        delta = target.points - point
        squared = delta[:, 0] ** 2 + delta[:, 1] ** 2 + delta[:, 2] ** 2
        nearest = int(squared.argmin())
        plane = target.normals[nearest]
        if squared[nearest] < config.tolerance_m**2 and normal @ plane > config.same_side_cosine:
            found.append((point, plane, float((point - target.points[nearest]) @ plane)))
    return found


def check_contact(source, target, T, config) -> int:
    contact, found = contact_between(source, target, T, config), brute_force_contact(source, target, T, config)
    expected = contact_of(*map(np.array, zip(*found, strict=True)))
    assert contact.num_points == expected.num_points
    np.testing.assert_allclose(
        contact.information, expected.information, rtol=1e-9, atol=1e-9 * np.abs(expected.information).max()
    )
    assert contact.sum_squared_m2 == pytest.approx(expected.sum_squared_m2, rel=1e-9)
    return len(found)


@pytest.mark.parametrize("tolerance", [0.4, 1.5])
def test_contact_of_random_scans_equals_all_pairs(tolerance):
    config = SightViewConfig(tolerance_m=tolerance)
    sizes = [check_contact(random_scan(900, s, 3.0), random_scan(800, s + 5, 3.0), POSE, config) for s in range(3)]
    assert min(sizes) > 5


def test_contact_of_real_scans_equals_all_pairs(shared_data):
    source, target, T, settings = real_pair(shared_data, "os1_64_seosan")
    source, target = (thin(preprocess(scan, settings.preprocess), 1500) for scan in (source, target))
    assert check_contact(source, target, T, SightViewConfig(tolerance_m=1.0)) > 200


def test_surfaces_that_face_away_or_lie_apart_are_no_contact():
    scan = random_scan(500, 1)
    inside_out = prepared(scan.points, -scan.normals)
    assert contact_between(scan, scan, np.eye(4), SightViewConfig()).num_points == 500
    for other, T in ((inside_out, np.eye(4)), (scan, shift(np.eye(4), np.array([0.0, 0.0, 1.0]), 300.0))):
        nothing = contact_between(other, scan, T, SightViewConfig())
        assert nothing.num_points == 0
        assert nothing.weakest_direction()[1] == 0.0
        assert np.isfinite(nothing.covariance(CONFIG)).all()


@pytest.mark.parametrize("seed", range(4))
def test_information_is_the_curvature_of_the_squared_residuals(seed):
    """Second differences of sum (n . (perturbed p - p))^2 / 2 over small left perturbations."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(60, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = rng.normal(size=(60, 3)) * 5
    contact = contact_of(points, normals, np.zeros(60))

    def cost(step: np.ndarray) -> float:
        moved = Rotation.from_rotvec(step[3:]).apply(points) + step[:3]
        return 0.5 * float(np.square(np.einsum("ij,ij->i", normals, moved - points)).sum())

    size = 1e-4
    steps = size * np.eye(6)
    expected = np.array([[cost(a + b) - cost(a - b) for b in steps] for a in steps]) / (2 * size * size)
    np.testing.assert_allclose(contact.information, expected, rtol=1e-4, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(6))
def test_the_weakest_direction_is_the_weakest_of_all_directions(seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(300, 3)) * rng.uniform(0.05, 1.0, 3) @ Rotation.random(random_state=seed).as_matrix()
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    direction, strength = contact_of(normals, normals, np.zeros(300)).weakest_direction()
    sphere = rng.normal(size=(50_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    resistance = np.square(normals @ sphere.T).mean(0)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert np.square(normals @ direction).mean() == pytest.approx(strength)
    assert strength <= resistance.min() + 1e-12
    assert strength == pytest.approx(resistance.min(), rel=0.05)
    assert abs(direction @ sphere[resistance.argmin()]) > 0.99


def test_directions_that_are_evenly_held_have_a_third_each():
    assert contact_on({"x": 500, "y": 500, "z": 500}).weakest_direction()[1] == pytest.approx(1 / 3)


@pytest.mark.parametrize("axis", AXES)
def test_a_corridor_slips_along_itself(axis):
    across = {name: 1000 for name in AXES if name != axis}
    direction, strength = contact_on(across).weakest_direction()
    np.testing.assert_allclose(direction, AXES[axis], atol=1e-9)  # the sign is fixed: towards the larger entry
    assert strength == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_covariance_is_symmetric_positive_and_not_below_its_floor(seed):
    contact = contact_on(dict(zip(AXES, np.random.default_rng(seed).integers(0, 3000, 3), strict=True)), seed)
    for config in (CONFIG, CovarianceConfig(floor_translation_m=0.2, floor_rotation_deg=2.0)):
        covariance = contact.covariance(config)
        floor = np.diag([config.floor_translation_m**2] * 3 + [np.radians(config.floor_rotation_deg) ** 2] * 3)
        assert covariance.shape == (6, 6)
        np.testing.assert_array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert np.linalg.eigvalsh(covariance - floor).min() > -1e-12


def test_perfect_residuals_leave_the_floor():
    perfect = contact_on({"x": 5000, "y": 5000, "z": 5000}, noise_m=0.0)
    deviation = np.sqrt(np.diag(perfect.covariance(CONFIG)))
    np.testing.assert_allclose(deviation[:3], CONFIG.floor_translation_m, rtol=1e-3)
    np.testing.assert_allclose(deviation[3:], np.radians(CONFIG.floor_rotation_deg), rtol=1e-3)


def test_the_covariance_grows_along_a_corridor_only():
    deviation = {num: np.sqrt(np.diag(corridor(num).covariance(CONFIG))) for num in (0, 20, 1000)}
    assert deviation[0][0] > 5 * deviation[1000][0]
    assert deviation[0][0] > deviation[20][0] > deviation[1000][0]
    assert deviation[0][0] > 5 * deviation[0][1:3].max()
    np.testing.assert_allclose(deviation[0][1:3], deviation[1000][1:3], rtol=0.2)


def test_the_covariance_grows_with_noise_and_shrinks_with_surface():
    few, many, noisy = (contact_on(dict.fromkeys(AXES, n), noise_m=s) for n, s in ((300, 0.1), (3000, 0.1), (300, 0.4)))
    small, middle, large = (np.linalg.eigvalsh(c.covariance(CONFIG)) for c in (many, few, noisy))
    assert (small < middle).all()
    assert (middle < large).all()


def test_a_turned_world_has_the_turned_covariance():
    points, normals, residuals = constraints_on({"y": 1000, "z": 1000, "x": 50})
    R = Rotation.random(random_state=3).as_matrix()
    contact, turned = contact_of(points, normals, residuals), contact_of(points @ R.T, normals @ R.T, residuals)
    both = np.kron(np.eye(2), R)
    np.testing.assert_allclose(turned.covariance(CONFIG), both @ contact.covariance(CONFIG) @ both.T, atol=1e-9)


def test_a_slip_moves_the_pose_in_the_target_frame_and_nothing_else():
    direction = np.array([0.6, 0.0, 0.8])
    before = POSE.copy()
    moved = shift(POSE, direction, 2.5)
    np.testing.assert_allclose(moved[:3, 3] - POSE[:3, 3], 2.5 * direction)
    np.testing.assert_array_equal(moved[:3, :3], POSE[:3, :3])
    np.testing.assert_array_equal(POSE, before)
    assert_same_pose(shift(moved, direction, -2.5), POSE, 1e-6, 1e-12)
