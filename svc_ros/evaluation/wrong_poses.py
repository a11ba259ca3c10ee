"""Poses to accept or to refuse, made from pairs with a known pose: each is near enough to the truth to be mistaken.

Slips and turns lie in the plane of the target's x and y, where vehicles and robots err; everything comes from a
generator that is passed in, so the same pairs give the same poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.scan import Array
from svc_ros.core.se3 import make_pose, pose_error
from svc_ros.io.datasets import Candidate, SuccessThresholds

CORRECT, WRONG, GREY = "correct", "wrong", "grey"
REFERENCE, SLIP, TURN, FAR = "reference", "slip", "turn", "far"  # how a pose was made
GREY_FACTOR = 2.0  # poses between the success thresholds and so many times those are neither right nor wrong

_SLIP_THRESHOLDS = (GREY_FACTOR, 8.0)
_TURN_DEG = (15.0, 180.0)
_NUM_FAR = 2
_NUM_FAR_OF_NEGATIVE = 4
_EDGE = 1.02  # a pose at the edge of grey is made a bit worse than that


def label_of(T_target_source: Array, T_reference: Array, success: SuccessThresholds) -> str:
    """`correct` within both thresholds, `wrong` beyond twice either of them, else `grey`; poses (4, 4) [m]."""
    rotation, translation = pose_error(T_target_source, T_reference)
    share = max(rotation / success.rotation_deg, translation / success.translation_m)
    return CORRECT if share <= 1.0 else GREY if share <= GREY_FACTOR else WRONG


def poses_of_pair(
    T_reference: Array, others: Sequence[Array], success: SuccessThresholds, rng: np.random.Generator
) -> tuple[Candidate, ...]:
    """The reference (4, 4) [m], four slips, four turns, and two of the poses of `others` that are wrong here.

    Slips go both ways along x and y of the target, by two to eight thresholds; turns are about the source's own z
    axis, by 15 to 180 deg and always beyond the grey ones. One of each is drawn from every part of its range.
    """
    made = [Candidate(T_reference, CORRECT, REFERENCE)]
    made += [Candidate(T, WRONG, SLIP) for T in _slips(T_reference, success, rng)]
    made += [Candidate(T, WRONG, TURN) for T in _turns(T_reference, success, rng)]
    return (*made, *_far(T_reference, _shuffled(others, rng), success, _NUM_FAR))


def poses_of_negative(
    T_reference: Array | None, others: Sequence[Array], success: SuccessThresholds, rng: np.random.Generator
) -> tuple[Candidate, ...]:
    """Wrong poses of scans that see nothing in common: no motion at all, and the poses of four other pairs.

    T_reference: (4, 4) [m] where it is known after all; what is not wrong by it is left out.
    """
    still = _far(T_reference, [np.eye(4)], success, 1)
    return still + _far(T_reference, _shuffled(others, rng), success, _NUM_FAR_OF_NEGATIVE)


def _slips(T: Array, success: SuccessThresholds, rng: np.random.Generator) -> Iterator[Array]:
    directions = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    distances_m = success.translation_m * _strata((_EDGE * _SLIP_THRESHOLDS[0], _SLIP_THRESHOLDS[1]), 4, rng)
    for direction, distance_m in zip(directions, rng.permutation(distances_m), strict=True):
        yield make_pose(T[:3, :3], T[:3, 3] + distance_m * direction)


def _turns(T: Array, success: SuccessThresholds, rng: np.random.Generator) -> Iterator[Array]:
    least_deg = min(max(_TURN_DEG[0], _EDGE * GREY_FACTOR * success.rotation_deg), _TURN_DEG[1])
    angles_deg = _strata((least_deg, _TURN_DEG[1]), 3, rng) * rng.choice([-1.0, 1.0], 3)
    for angle_deg in (*angles_deg, _TURN_DEG[1]):  # half a turn is what corridors and streets are mistaken by
        turn = Rotation.from_euler("z", angle_deg, degrees=True).as_matrix()
        yield make_pose(T[:3, :3] @ turn, T[:3, 3])


def _far(
    T_reference: Array | None, others: Sequence[Array], success: SuccessThresholds, num: int
) -> tuple[Candidate, ...]:
    """The first poses of `others` that are wrong, `num` at most."""
    wrong = (T for T in others if T_reference is None or label_of(T, T_reference, success) == WRONG)
    return tuple(Candidate(T, WRONG, FAR) for T in islice(wrong, num))


def _shuffled(poses: Sequence[Array], rng: np.random.Generator) -> list[Array]:
    return [poses[k] for k in rng.permutation(len(poses))]


def _strata(limits: tuple[float, float], num: int, rng: np.random.Generator) -> Array:
    """One number (num,) from each of as many equal parts of a range, in ascending order."""
    low, high = limits
    return np.asarray(low + (high - low) * (np.arange(num) + rng.random(num)) / num)
