"""What must not matter does not: which scan comes first, the frame a scan is written in, the order of its points."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from assertions import assert_same_bits, assert_same_pose
from scan_cases import real_pair
from scipy.spatial.transform import Rotation
from simulated_scans import Place, moved, scan_at

from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.registration import register, verify
from svc_ros.core.result import RegistrationResult, Verdict
from svc_ros.core.scan import Array, Scan

Case = tuple[Scan, Scan, Array, Config]
PAIRS = {
    "street": (Place("street", "VLP-16", 2, 24.0, 20.0), Place("street", "VLP-16", 2, 20.0), "lidar_outdoor"),
    "indoor": (Place("indoor", "VLP-16", 2, 21.0, 30.0), Place("indoor", "VLP-16", 2, 20.0), "lidar_indoor"),
    "unrelated": (Place("indoor", "VLP-16", 3, 21.0), Place("indoor", "VLP-16", 4, 20.0), "lidar_indoor"),
}
ONE_TURN = Rotation.from_euler("zyx", [110.0, 0.0, 0.0], degrees=True).as_matrix()
TUMBLED = Rotation.from_euler("zyx", [40.0, 25.0, -35.0], degrees=True).as_matrix()


def case_of(name: str) -> Case:
    source, target, preset_name = PAIRS[name]
    (source_scan, T_source), (target_scan, T_target) = scan_at(source), scan_at(target)
    return source_scan, target_scan, se3.invert(T_target) @ T_source, preset(preset_name)


@lru_cache(maxsize=8)
def registered(name: str) -> RegistrationResult:
    source, target, _, config = case_of(name)
    return register(source, target, config)


def in_other_frame(scan: Scan, T: Array) -> Scan:
    """The same scan written in another frame: its sensor stands elsewhere in it."""
    return Scan(se3.apply(T, scan.points), scan.stamp_ns, scan.frame_id, se3.apply(T, scan.sensor_origin[None])[0])


def assert_same_numbers(found: RegistrationResult, expected: RegistrationResult) -> None:
    assert (found.verdict, found.reason) == (expected.verdict, expected.reason)
    assert_same_bits(found.best_candidate, expected.best_candidate)
    assert found.probability == expected.probability
    assert found.evidence.numbers() == expected.evidence.numbers()
    assert dict(found.counts) == dict(expected.counts)
    if expected.covariance is not None:
        assert_same_bits(found.covariance, expected.covariance)


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_these_pairs_are_accepted_and_right(name):
    assert registered(name).verdict is Verdict.ACCEPTED
    assert_same_pose(registered(name).T_target_source, case_of(name)[2], 1.0, 0.15)


@pytest.mark.parametrize("name", PAIRS)
def test_exchanged_scans_give_the_same_verdict_and_the_inverse_pose(name):
    source, target, _, config = case_of(name)
    there, back = registered(name), register(target, source, config)
    assert back.verdict is there.verdict
    if there.accepted:
        assert_same_pose(back.T_target_source @ there.T_target_source, np.eye(4), 0.5, 0.1)
        assert back.probability == pytest.approx(there.probability, abs=0.05)


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_exchanged_scans_verify_alike(name):
    source, target, T, config = case_of(name)
    for pose in (T, moved(T, (3.0, 1.0, 0.0)), moved(T, (0.0, 0.0, 0.0), "z", 90.0)):
        there, back = verify(source, target, pose, config), verify(target, source, se3.invert(pose), config)
        assert back.verdict is there.verdict
        if there.accepted:
            assert_same_pose(back.T_target_source @ there.T_target_source, np.eye(4), 0.5, 0.1)


@pytest.mark.slow
def test_exchanged_real_scans_give_the_same_verdict_and_the_inverse_pose(shared_data):
    source, target, _, config = real_pair(shared_data, "hdl64_kitti_05_loop")
    there, back = register(source, target, config), register(target, source, config)
    assert there.verdict is back.verdict is Verdict.ACCEPTED
    assert_same_pose(back.T_target_source @ there.T_target_source, np.eye(4), 0.5, 0.15)


@pytest.mark.parametrize("which", ["source", "target", "both"])
@pytest.mark.parametrize("rotation", [ONE_TURN, TUMBLED], ids=["level", "tumbled"])
@pytest.mark.parametrize("name", ["street", "indoor"])
def test_the_frame_of_a_scan_does_not_matter(name, rotation, which):
    """Nothing knows where up is, nor that a sensor stands at zero; only the voxels (0.3, 0.4 m) fall differently."""
    source, target, _, config = case_of(name)
    M = se3.make_pose(rotation, (20.0, -7.0, 3.0))
    A, B = (M if which in (side, "both") else np.eye(4) for side in ("source", "target"))
    result = register(in_other_frame(source, A), in_other_frame(target, B), config)
    assert result.verdict is registered(name).verdict
    assert_same_pose(se3.invert(B) @ result.best_candidate @ A, registered(name).best_candidate, 1.0, 0.15)


def test_unrelated_scans_stay_unrelated_in_any_frame():
    source, target, _, config = case_of("unrelated")
    for rotation in (ONE_TURN, TUMBLED):
        M = se3.make_pose(rotation, (20.0, -7.0, 3.0))
        assert not register(in_other_frame(source, M), in_other_frame(target, M), config).accepted


def shuffled(scan: Scan) -> Scan:
    return Scan(np.random.default_rng(1).permutation(scan.points), scan.stamp_ns, scan.frame_id)


def twice(scan: Scan) -> Scan:
    return Scan(np.repeat(scan.points, 2, axis=0), scan.stamp_ns, scan.frame_id)


def untouched(scan: Scan) -> Scan:
    return Scan(scan.points.copy(), scan.stamp_ns, scan.frame_id)


@pytest.mark.parametrize("change", [untouched, shuffled, twice])
@pytest.mark.parametrize("name", PAIRS)
def test_order_doubled_points_and_repetition_leave_every_bit(name, change: Callable[[Scan], Scan]):
    source, target, T, config = case_of(name)
    assert_same_numbers(register(change(source), change(target), config), registered(name))
    poses = (T, moved(T, (0.2, 0.1, 0.0)))
    for pose in poses:
        assert_same_numbers(verify(change(source), change(target), pose, config), verify(source, target, pose, config))


@pytest.mark.parametrize("name", ["street", "indoor"])
def test_some_points_twice_change_little(name):
    """They weigh more in their voxel's mean, nowhere else."""
    source, target, _, config = case_of(name)
    some = [Scan(np.concatenate([s.points, s.points[::7]])) for s in (source, target)]
    result = register(*some, config)
    assert result.verdict is registered(name).verdict
    assert_same_pose(result.best_candidate, registered(name).best_candidate, 0.3, 0.05)
