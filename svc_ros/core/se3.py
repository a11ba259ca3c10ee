"""Rigid motions as 4x4 matrices.

A pose `T_target_source` maps source points into the target frame: p_target = R p_source + t.
Batches carry the pose index first, (H, 4, 4). Angles leave this module in degrees, lengths in metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError

Array = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-4  # accepts matrices printed with five digits
_NEARLY, _EXACT, _STEPS = 0.3, 4e-16, 8  # a rotation but for rounding: then a few steps lead to the nearest one
RANK_TOLERANCE = 1e-6  # second singular value over the first, below which a point set is a line


def make_pose(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Join rotations (..., 3, 3) and translations (..., 3) [m] into poses (..., 4, 4)."""
    R, t = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def half_turn(axis: Array, middle: Array) -> Array:
    """The pose (4, 4) that turns by half a circle about a unit axis (3,) through a point (3,) [m]."""
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    return make_pose(R, middle - R @ middle)


def invert(T: ArrayLike) -> Array:
    """Invert poses (..., 4, 4): T_source_target from T_target_source."""
    T = np.asarray(T, np.float64)
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_pose(R_inv, -(R_inv @ T[..., :3, 3:])[..., 0])


def apply(T: ArrayLike, points: ArrayLike) -> Array:
    """Map points (N, 3) [m] with one pose (4, 4)."""
    T = np.asarray(T, np.float64)
    return np.asarray(np.asarray(points, np.float64) @ T[:3, :3].T + T[:3, 3])


def rotate(T: ArrayLike, vectors: ArrayLike) -> Array:
    """Rotate directions (N, 3) with one pose (4, 4); the translation does not act."""
    return np.asarray(np.asarray(vectors, np.float64) @ np.asarray(T, np.float64)[:3, :3].T)


def rotation_angle_deg(R: ArrayLike) -> Array:
    """Angle [deg] of rotations (..., 3, 3), exact near 0 and near 180 deg."""
    R = np.asarray(R, np.float64)
    twice_odd = R - np.swapaxes(R, -1, -2)
    sine = np.sqrt(np.square(twice_odd).sum((-2, -1)) / 8.0)
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))


def turn_onto(direction: ArrayLike, onto: ArrayLike) -> Array:
    """The rotation (3, 3) by the smallest angle that turns one unit vector onto another, less than 180 deg away."""
    a, b = np.asarray(direction, np.float64), np.asarray(onto, np.float64)
    x, y, z = np.cross(a, b)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + a @ b))


def pose_error(T_estimate: ArrayLike, T_reference: ArrayLike) -> tuple[float, float]:
    """Rotation error [deg] and translation error [m] of an estimate (paper: RE and TE)."""
    A, B = np.asarray(T_estimate, np.float64).tolist(), np.asarray(T_reference, np.float64).tolist()
    R = [[sum(A[k][i] * B[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
    sine = 0.5 * math.hypot(R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1])
    cosine = 0.5 * (R[0][0] + R[1][1] + R[2][2] - 1.0)
    return math.degrees(math.atan2(sine, cosine)), math.dist([row[3] for row in A[:3]], [row[3] for row in B[:3]])


def check_pose(T: ArrayLike, name: str = "T_target_source") -> Array:
    """Return `T` as a float64 (4, 4) rigid motion or raise InputError saying what is wrong with it."""
    try:
        pose = np.asarray(T, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a 4x4 matrix of numbers, found {T!r:.80}") from None
    if pose.shape != (4, 4):
        raise InputError(f"{name}: expected a 4x4 matrix, found shape {pose.shape}")
    if not np.isfinite(pose).all():
        raise InputError(f"{name}: expected finite numbers, found NaN or inf")
    if np.abs(pose[3] - (0, 0, 0, 1)).max() > _ROTATION_TOLERANCE:
        raise InputError(f"{name}: expected the last row 0 0 0 1, found {pose[3].tolist()}")
    R = pose[:3, :3].tolist()
    if _gap(_gram(R)) > 10 * _ROTATION_TOLERANCE or _determinant(R) < 0:
        raise InputError(f"{name}: its upper left 3x3 block is not a rotation")
    return pose


def nearest_pose(T: ArrayLike) -> Array:
    """Project the rotation block of (4, 4) onto SO(3): undoes the rounding of poses read from text."""
    T = np.asarray(T, np.float64)
    R = T[:3, :3].tolist()
    gram = _gram(R)
    if not (_gap(gram) < _NEARLY and _determinant(R) > 0.0):
        U, _, Vt = np.linalg.svd(T[:3, :3])
        U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
        return make_pose(U @ Vt, T[:3, 3])
    for _ in range(_STEPS):  # Newton and Schulz: twice the digits in every step
        if _gap(gram) < _EXACT:
            break
        step = [[(1.5 if i == j else 0.0) - 0.5 * gram[i][j] for j in range(3)] for i in range(3)]
        R = [[sum(row[k] * step[k][j] for k in range(3)) for j in range(3)] for row in R]
        gram = _gram(R)
    return make_pose(R, T[:3, 3])


def _gram(R: list[list[float]]) -> list[list[float]]:
    """R^T R. A few numbers without a library call: that costs more where it has not been made just before."""
    return [[sum(R[k][i] * R[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def _gap(gram: list[list[float]]) -> float:
    """How far from the identity its worst entry is."""
    return max(abs(gram[i][j] - (i == j)) for i in range(3) for j in range(3))


def _determinant(R: list[list[float]]) -> float:
    (a, b, c), (d, e, f), (g, h, i) = R
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def kabsch(source: ArrayLike, target: ArrayLike, weights: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Weighted least-squares poses of H point sets at once.

    source, target: (H, K, 3) [m]; weights: (H, K), not negative. Returns poses (H, 4, 4) and a mask (H,)
    that is False where the weighted points span less than a plane's two directions (a line or a point),
    where no rotation is determined. Such a row holds NaN: a degenerate set has no pose.
    """
    x, y, w = (np.asarray(a, np.float64) for a in (source, target, weights))
    total = w.sum(-1, keepdims=True)
    w = np.divide(w, total, out=np.zeros_like(w), where=total > 0)
    mean_x, mean_y = np.einsum("hk,hki->hi", w, x), np.einsum("hk,hki->hi", w, y)
    cov = np.einsum("hk,hki,hkj->hij", w, x - mean_x[:, None], y - mean_y[:, None])
    cov = np.where(np.isfinite(cov), cov, 0.0)
    U, singular, Vt = np.linalg.svd(cov)
    V = np.swapaxes(Vt, -1, -2)
    sign = np.where(np.linalg.det(V @ np.swapaxes(U, -1, -2)) < 0, -1.0, 1.0)
    V[..., :, 2] *= sign[:, None]  # a reflection is turned into the nearest rotation
    R = V @ np.swapaxes(U, -1, -2)
    valid = (singular[:, 0] > 0) & (singular[:, 1] > RANK_TOLERANCE * singular[:, 0])
    T = make_pose(R, mean_y - np.einsum("hij,hj->hi", R, mean_x))
    T[~valid] = np.nan
    return T, valid
