"""In simulated worlds, where the truth is known: what is accepted is right, and the right is accepted.

A failure names the world, the sensor and the seed, and the evidence that misled.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest
from simulated_scans import (
    Place,
    SimulatedPair,
    falsehood,
    features_at,
    is_right,
    moved,
    pair_at,
    scan_at,
    wrong_poses,
)

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import extract_features, register, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.simulation.drive import DriveConfig, drive_scans

# (preset, sensor, seed, way between the scans [m])
CORRIDORS = [
    ("lidar_indoor", "OS0-64", 1, 3.0), ("lidar_indoor", "OS0-64", 2, 1.0), ("lidar_indoor", "OS0-64", 3, 6.0),
    ("lidar_indoor", "VLP-16", 1, 1.0), ("lidar_indoor", "VLP-16", 2, 6.0), ("lidar_indoor", "VLP-16", 3, 3.0),
    ("lidar_indoor", "OS1-64", 1, 1.0), ("lidar_indoor", "OS1-64", 2, 6.0), ("lidar_indoor", "OS1-64", 3, 3.0),
    ("lidar_indoor", "HDL-32E", 2, 3.0), ("lidar_indoor", "HDL-64E", 1, 6.0),
    ("lidar_outdoor", "VLP-16", 2, 3.0), ("lidar_outdoor", "VLP-16", 5, 3.0), ("lidar_outdoor", "OS1-64", 1, 3.0),
    ("lidar_outdoor", "OS0-64", 2, 6.0), ("lidar_outdoor", "HDL-32E", 1, 1.0),
]  # fmt: skip
FURNISHED = [
    ("lidar_indoor", "VLP-16", 2, 1.0), ("lidar_indoor", "VLP-16", 4, 6.0), ("lidar_indoor", "VLP-16", 5, 6.0),
    ("lidar_indoor", "VLP-16", 1, 3.0), ("lidar_indoor", "OS1-64", 2, 6.0), ("lidar_indoor", "OS1-64", 4, 6.0),
    ("lidar_indoor", "OS1-64", 6, 6.0), ("lidar_indoor", "OS1-64", 1, 3.0), ("lidar_indoor", "HDL-64E", 6, 6.0),
    ("lidar_indoor", "HDL-64E", 3, 3.0), ("lidar_indoor", "HDL-32E", 3, 3.0), ("lidar_indoor", "HDL-32E", 2, 1.0),
    ("lidar_indoor", "OS0-64", 1, 1.0), ("lidar_indoor", "OS0-64", 2, 3.0), ("lidar_indoor", "OS0-64", 4, 3.0),
    ("lidar_outdoor", "HDL-64E", 2, 6.0), ("lidar_outdoor", "VLP-16", 1, 3.0), ("lidar_outdoor", "HDL-32E", 4, 3.0),
]  # fmt: skip
STREETS = [("OS1-64", 1), ("VLP-16", 2), ("HDL-64E", 3)]
ROOMS = [("OS0-64", 2), ("VLP-16", 2), ("OS1-64", 3)]


def corridor_pair(scene: str, case: tuple[str, str, int, float]) -> tuple[SimulatedPair, np.ndarray]:
    """Two scans and the corridor's axis (3,) in the target's frame."""
    preset_name, sensor, seed, gap_m = case
    target = Place(scene, sensor, seed, 10.0)
    turn_deg = 25.0 * ((seed + round(gap_m)) % 2)
    pair = pair_at(Place(scene, sensor, seed, 10.0 + gap_m, turn_deg), target, preset_name)
    return pair, scan_at(target)[1][:3, :3].T @ (1.0, 0.0, 0.0)


@functools.cache
def registered_in_a_furnished_corridor(case: tuple) -> RegistrationResult:
    pair, _ = corridor_pair("corridor_features", case)
    return register(pair.source, pair.target, pair.config)


def ids(cases: list) -> list[str]:
    return ["-".join(str(part) for part in case) for case in cases]


# Corridors


@pytest.mark.parametrize(
    "case",
    [case if k % 2 else pytest.param(case, marks=pytest.mark.slow) for k, case in enumerate(CORRIDORS)],
    ids=ids(CORRIDORS),
)
def test_in_a_bare_corridor_registration_is_undecided_along_it(case):
    """Both ends look the same as well: the pose may be turned by half, but it points along the corridor."""
    pair, axis = corridor_pair("corridor", case)
    result = register(pair.source, pair.target, pair.config)
    assert result.verdict is Verdict.UNDECIDED, falsehood(result, pair.T) or result.detail
    assert result.reason in (Reason.AMBIGUOUS, Reason.INSUFFICIENT_EVIDENCE)
    assert result.T_target_source is None
    heading = se3.invert(pair.T)[:3, :3] @ axis
    assert abs((result.best_candidate[:3, :3] @ heading) @ axis) > np.cos(np.radians(5.0))


@pytest.mark.parametrize("case", CORRIDORS, ids=ids(CORRIDORS))
def test_in_a_bare_corridor_no_pose_along_it_is_accepted(case):
    """Not even the right one: there is nothing to tell it by."""
    pair, axis = corridor_pair("corridor", case)
    for slip_m in (0.0, 1.5, -2.5):
        result = verify(pair.source, pair.target, moved(pair.T, tuple(slip_m * axis)), pair.config)
        assert not result.accepted, f"slipped by {slip_m} m: {falsehood(result, pair.T) or result.detail}"
        assert result.reason in (Reason.AMBIGUOUS, Reason.INSUFFICIENT_EVIDENCE)


def test_a_furnished_corridor_is_accepted_in_a_fair_share():
    right = []
    for case in FURNISHED:
        pair, _ = corridor_pair("corridor_features", case)
        result = registered_in_a_furnished_corridor(case)
        right.append(result.accepted and is_right(result, pair.T))
    assert sum(right) >= len(FURNISHED) // 3, list(zip(ids(FURNISHED), right, strict=True))


@pytest.mark.parametrize("case", FURNISHED, ids=ids(FURNISHED))
def test_in_a_furnished_corridor_nothing_wrong_is_accepted(case):
    pair, axis = corridor_pair("corridor_features", case)
    found = {"register": registered_in_a_furnished_corridor(case)}
    for slip_m in (1.5, -2.5):
        slipped = moved(pair.T, tuple(slip_m * axis))
        found[f"slip of {slip_m} m"] = verify(pair.source, pair.target, slipped, pair.config)
    for where, result in found.items():
        assert not falsehood(result, pair.T), f"{where}: {falsehood(result, pair.T)}"


# Things that move


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("sensor", ["HDL-64E", "OS1-64", "VLP-16"])
def test_half_of_the_parked_cars_gone_does_not_make_a_pose_wrong(sensor, seed):
    places = (Place("street", sensor, seed, 24.0, 11.0, 60.0, 0.5), Place("street", sensor, seed, 20.0, 0.0, 0.0, 0.5))
    pair = pair_at(*places, "lidar_outdoor")
    result = verify(pair.source, pair.target, pair.T, pair.config)
    if sensor == "VLP-16":  # its surfaces lie on each other less tightly: a pose may stay undecided
        assert result.verdict is not Verdict.REJECTED, f"{result.reason.value}: {result.detail}"
    else:
        assert result.accepted, f"{result.reason.value}: {result.detail}"
    assert se3.pose_error(result.best_candidate, pair.T)[1] < 0.3
    blocked = max(result.evidence.source_in_target.num_blocked, result.evidence.target_in_source.num_blocked)
    assert blocked > 20  # the cars that left do contradict


def in_traffic(sensor: str, seed: int, time_s: float) -> SimulatedPair:
    """Half of everything that can move does; so much later, four metres on."""
    target = Place("street", sensor, seed, 20.0, moving_share=0.5)
    return pair_at(Place("street", sensor, seed, 24.0, 11.0, time_s, 0.0, 0.5), target, "lidar_outdoor")


@pytest.mark.parametrize("time_s", [2.0, 60.0])
@pytest.mark.parametrize(("sensor", "seed"), [("HDL-64E", 1), ("HDL-64E", 3), ("OS1-64", 2)])
def test_traffic_does_not_hide_the_way(sensor, seed, time_s):
    pair = in_traffic(sensor, seed, time_s)
    result = register(pair.source, pair.target, pair.config)
    assert result.accepted, f"{result.reason.value}: {result.detail}"
    assert is_right(result, pair.T)


def test_traffic_before_a_sensor_of_16_beams_leaves_some_pairs_open():
    """Its surfaces lie on each other less tightly, so less traffic is made good."""
    pairs = [in_traffic("VLP-16", seed, time_s) for seed in (2, 3, 4) for time_s in (2.0, 60.0)]
    results = [verify(pair.source, pair.target, pair.T, pair.config) for pair in pairs]
    assert sum(result.accepted for result in results) >= 4
    assert all(is_right(r, p.T) for r, p in zip(results, pairs, strict=True) if r.accepted)


@pytest.mark.parametrize(
    ("sensor", "seed"),
    [
        ("OS0-64", 2),
        ("VLP-16", 1),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in (("OS0-64", 10), ("OS1-64", 3))),
    ],
)
def test_rooms_of_two_buildings_that_look_alike_are_not_accepted(sensor, seed):
    """Corridors and rooms of about equal size: much agrees, little is blocked, but nothing fits tightly."""
    scans = list(drive_scans(DriveConfig("indoor", sensor, 9, 0.5, 2.0, seed, teleport_after=5)))
    for before, after in ((5, 6), (0, 7)):
        pair = [extract_features(scans[k].cast.scan(), preset("lidar_indoor")) for k in (after, before)]
        result = register(*pair, preset("lidar_indoor"))
        assert not result.accepted, falsehood(result, None)


# Wrong poses, wrong scans


def still_pair(scene: str, sensor: str, seed: int) -> SimulatedPair:
    preset_name, gap_m = ("lidar_outdoor", 4.0) if scene == "street" else ("lidar_indoor", 1.0)
    target = Place(scene, sensor, seed, 20.0)
    return pair_at(Place(scene, sensor, seed, 20.0 + gap_m, 20.0), target, preset_name)


@pytest.mark.parametrize(
    ("scene", "sensor", "seed"), [("street", *c) for c in STREETS] + [("indoor", *c) for c in ROOMS]
)
def test_the_right_pose_is_accepted_and_no_pose_beside_it(scene, sensor, seed):
    """Poses metres away or turned by 15 deg and more."""
    pair = still_pair(scene, sensor, seed)
    assert verify(pair.source, pair.target, pair.T, pair.config).accepted
    for k, T in enumerate(wrong_poses(pair.T, 12, seed)):
        result = verify(pair.source, pair.target, T, pair.config)
        assert not falsehood(result, pair.T), f"pose {k}: {falsehood(result, pair.T)}"
        assert not result.accepted, f"pose {k} was moved back to the truth, and is not what was asked about"


@pytest.mark.parametrize(
    ("scene", "sensor", "seed"), [("street", *c) for c in STREETS] + [("indoor", *c) for c in ROOMS]
)
def test_mirrored_and_distant_poses_are_rejected(scene, sensor, seed):
    """Upside down, about face, a storey up or down, far away. About face in a plain corridor may stay undecided."""
    pair = still_pair(scene, sensor, seed)
    poses = {
        "upside down": moved(pair.T, (0, 0, 0), "x", 180.0),
        "about face": moved(pair.T, (0, 0, 0), "z", 180.0),
        "storey up": moved(pair.T, (0, 0, 3.0)),
        "storey down": moved(pair.T, (0, 0, -3.0)),
        "far away": moved(pair.T, (300.0, 0, 0)),
    }
    for name, T in poses.items():
        result = verify(pair.source, pair.target, T, pair.config)
        assert not result.accepted, f"{name}: {result.detail}"
        if (scene, name) != ("indoor", "about face"):
            assert result.verdict is Verdict.REJECTED, f"{name}: {result.verdict.value}, {result.detail}"


UNRELATED = [("street", "lidar_outdoor", "VLP-16"), ("indoor", "lidar_indoor", "VLP-16"),
             ("indoor", "lidar_indoor", "OS0-64"), ("indoor", "lidar_indoor", "OS1-64")]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "preset_name", "sensor"), UNRELATED)
def test_scans_of_different_worlds_are_never_accepted(scene, preset_name, sensor):
    """Every pair of four worlds, 24 in all. Corridors of two buildings are alike but for their widths."""
    scans = [features_at(Place(scene, sensor, 100 + k, 12.0 + 3 * k, 33.0 * k), preset_name) for k in range(4)]
    for i, j in itertools.combinations(range(4), 2):
        result = register(scans[i], scans[j], preset(preset_name))
        assert not result.accepted, f"worlds {100 + i} and {100 + j}: {falsehood(result, None)}"
