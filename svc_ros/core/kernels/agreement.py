"""Hot loop that refines poses on the correspondences they agree with; no GIL. Twins: test/support/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

from svc_ros.core.se3 import RANK_TOLERANCE

_jit = njit(nogil=True, cache=True, error_model="numpy")


@_jit
def refine(T, x, y, threshold, eps, rounds):  # type: ignore[no-untyped-def]
    """T (4, 4), in place: weighted least squares on the inliers of x, y (C, 3), until their number stays the same.

    Weights 1 / (1 + (e / eps)^2) of the residuals e below the threshold; the pose stays where they determine none.
    """
    num, previous = x.shape[0], -1
    weights = np.zeros(num)
    for _ in range(rounds):
        inliers = 0
        for c in range(num):
            sq = 0.0
            for i in range(3):
                d = T[i, 0] * x[c, 0] + T[i, 1] * x[c, 1] + T[i, 2] * x[c, 2] + T[i, 3] - y[c, i]
                sq += d * d
            inlier = sq < threshold * threshold
            inliers += inlier
            weights[c] = 1.0 / (1.0 + sq / (eps * eps)) if inlier else 0.0
        if inliers == previous or inliers == 0:
            return
        previous = inliers
        if not _fit(x, y, weights, T):
            return


@_jit
def _fit(x, y, weights, T):  # type: ignore[no-untyped-def]
    """The pose T (4, 4) that moves x onto y with least squares; False, and T as it was, where none is determined."""
    total, mean_x, mean_y, cov = 0.0, np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for c in range(x.shape[0]):
        if weights[c] > 0.0:
            total += weights[c]
            for i in range(3):
                mean_x[i] += weights[c] * x[c, i]
                mean_y[i] += weights[c] * y[c, i]
    mean_x, mean_y = mean_x / total, mean_y / total
    for c in range(x.shape[0]):
        if weights[c] > 0.0:
            for i in range(3):
                for j in range(3):
                    cov[i, j] += weights[c] * (x[c, i] - mean_x[i]) * (y[c, j] - mean_y[j])
    U, singular, Vt = np.linalg.svd(cov)
    if not singular[1] > RANK_TOLERANCE * singular[0]:
        return False
    V = np.ascontiguousarray(Vt.T)
    if np.linalg.det(V) * np.linalg.det(U) < 0.0:
        V[:, 2] *= -1.0
    R = V @ np.ascontiguousarray(U.T)
    T[:3, :3] = R
    T[:3, 3] = mean_y - R @ mean_x
    return True
