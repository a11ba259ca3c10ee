"""How well two loops fit together along the odometry between them, and one loop with odometry alone.

Everything is measured at the source: where one loop puts it in its target's frame, and where the other one does by way
of its own two places. What lies between counts with the drift that odometry may have there, with its lever arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.scan import Array

_STEADY_M = 20.0  # an error that grows evenly so far goes on like a random walk
_MOST_SQ_ERROR = 22.5  # of six degrees of freedom: all but one of 1000 right ones are below
_TURN_DRIFT = 0.02  # of an angle that odometry has turned by, the share that may be wrong


@dataclass(frozen=True, eq=False)
class PlacedLoop:
    """A loop and where odometry has its ends.

    T_target_source, T_odom_source, T_odom_target: (4, 4); covariance: (6, 6), as a result has it; source_way,
    target_way: (2,), how far the sensor had come until then [m] and how far it had turned [rad].
    """

    T_target_source: Array
    covariance: Array
    T_odom_source: Array
    T_odom_target: Array
    source_way: Array
    target_way: Array


@dataclass(frozen=True, eq=False)
class Fit:
    """sq_error: (L,), squared error over its covariance, six degrees of freedom; sigma_m: (L,), standard deviation
    along the direction in which least is known; shift_m: (L,), how far apart the two say that the source is."""

    sq_error: Array
    sigma_m: Array
    shift_m: Array

    @property
    def contradicts(self) -> NDArray[np.bool_]:
        """(L,), whether the two cannot both be right."""
        return self.sq_error > _MOST_SQ_ERROR


def fit_to_loops(this: PlacedLoop, others: Sequence[PlacedLoop], config: Config) -> Fit:
    """How well a loop fits each of the others; at least one of them."""
    T_others, T_odom_source, T_odom_target = (
        np.array([getattr(loop, name) for loop in others])
        for name in ("T_target_source", "T_odom_source", "T_odom_target")
    )
    covariances = np.array([loop.covariance for loop in others])
    T_between_targets = se3.invert(this.T_odom_target) @ T_odom_target
    T_in_other = T_others @ (se3.invert(T_odom_source) @ this.T_odom_source)
    lever = np.linalg.norm(T_in_other[:, :3, 3], axis=1)
    turned = np.kron(np.eye(2), T_between_targets[:, :3, :3])
    at_source = _at(T_in_other[:, :3, 3]) @ covariances @ np.swapaxes(_at(T_in_other[:, :3, 3]), -1, -2)
    covariance = turned @ at_source @ np.swapaxes(turned, -1, -2) + _own_covariance(this)
    for side, arm in (("source", np.zeros(len(others))), ("target", lever)):
        ways = np.array([getattr(loop, f"{side}_way") for loop in others]) - getattr(this, f"{side}_way")
        covariance = covariance + _drift(np.abs(ways), arm, config)
    return _fit(T_between_targets @ T_in_other, this.T_target_source, covariance)


def fit_to_odometry(this: PlacedLoop, config: Config) -> Fit:
    """How well a loop fits what odometry alone says of its ends; L is 1."""
    predicted = se3.invert(this.T_odom_target) @ this.T_odom_source
    drift = _drift(np.abs(this.source_way - this.target_way)[None], np.zeros(1), config)
    return _fit(predicted[None], this.T_target_source, drift + _own_covariance(this))


def ways_of(poses: Array) -> Array:
    """(N, 2): how far the sensor had come [m] and turned [rad] at each of its poses (N, 4, 4)."""
    steps = se3.invert(poses[:-1]) @ poses[1:]
    moved = np.linalg.norm(steps[:, :3, 3], axis=1)
    turned = np.radians(se3.rotation_angle_deg(steps[:, :3, :3]))
    return np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([moved, turned], axis=1), axis=0)])


def distance_between(this: PlacedLoop, others: Sequence[PlacedLoop]) -> Array:
    """(L,) [m], how far the places of loops are from those of this one, at the end where that is more."""
    ends = ("T_odom_source", "T_odom_target")
    each = [
        np.linalg.norm(np.array([getattr(loop, e)[:3, 3] for loop in others]) - getattr(this, e)[:3, 3], axis=1)
        for e in ends
    ]
    return np.asarray(np.maximum(*each))


def _fit(predicted: Array, T: Array, covariance: Array) -> Fit:
    shift = predicted[:, :3, 3] - T[:3, 3]
    turn = Rotation.from_matrix(predicted[:, :3, :3] @ T[:3, :3].T).as_rotvec()
    error = np.concatenate([shift, turn], axis=1)
    sq_error = np.einsum("li,li->l", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    sigma_m = np.sqrt(np.linalg.eigvalsh(covariance[:, :3, :3])[:, -1])
    return Fit(sq_error, sigma_m, np.linalg.norm(shift, axis=1))


def _own_covariance(loop: PlacedLoop) -> Array:
    at_source = _at(loop.T_target_source[None, :3, 3])[0]
    return np.asarray(at_source @ loop.covariance @ at_source.T)


def _at(points: Array) -> Array:
    """(L, 6, 6): a left perturbation as the shift of points (L, 3), and the turn."""
    x, y, z = points.T
    moved = np.tile(np.eye(6), (len(points), 1, 1))
    moved[:, 0, 4], moved[:, 0, 5], moved[:, 1, 5] = z, -y, x
    moved[:, 1, 3], moved[:, 2, 3], moved[:, 2, 4] = -z, y, -x
    return moved


def _drift(ways: Array, arm_m: Array, config: Config) -> Array:
    """Covariance (L, 6, 6) of odometry over ways (L, 2) [m, rad], seen `arm_m` (L,) from their end."""
    limits, floor = config.agreement, config.covariance
    length, turned = ways.T
    steady = np.minimum(length, np.sqrt(length * _STEADY_M))
    has_moved: NDArray[np.bool_] = length + turned > 0.0
    turn = np.radians(has_moved * floor.floor_rotation_deg + limits.drift_deg_per_metre * steady) + _TURN_DRIFT * turned
    # A turn that grows along the way moves its end by half of it times the way.
    shift = has_moved * floor.floor_translation_m + limits.drift_ratio * steady
    variance = shift**2 + (turn * (arm_m + 0.5 * length)) ** 2
    covariance = np.zeros((len(ways), 6, 6))
    covariance[:, [0, 1, 2], [0, 1, 2]] = variance[:, None]
    covariance[:, [3, 4, 5], [3, 4, 5]] = (turn**2)[:, None]
    return covariance
