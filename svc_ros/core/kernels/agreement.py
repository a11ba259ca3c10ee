"""Hot loop that refines poses on the correspondences they agree with; no GIL. Twins: test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.se3 import RANK_TOLERANCE

_jit = kernel()


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
    for i in range(3):
        mean_x[i], mean_y[i] = mean_x[i] / total, mean_y[i] / total
    for c in range(x.shape[0]):
        if weights[c] > 0.0:
            for i in range(3):
                for j in range(3):
                    cov[i, j] += weights[c] * (x[c, i] - mean_x[i]) * (y[c, j] - mean_y[j])
    U, singular, Vt = np.linalg.svd(cov)
    if not singular[1] > RANK_TOLERANCE * singular[0]:
        return False
    V, Ut = np.ascontiguousarray(Vt.T), np.ascontiguousarray(U.T)
    if _determinant(V) * _determinant(Ut) < 0.0:
        for i in range(3):
            V[i, 2] *= -1.0
    R = V @ Ut
    turned = R @ mean_x
    for i in range(3):  # entry by entry: whole arrays bring along the message on shapes that differ, long to compile
        for j in range(3):
            T[i, j] = R[i, j]
        T[i, 3] = mean_y[i] - turned[i]
    return True


@_jit
def _determinant(M):  # type: ignore[no-untyped-def]
    """Of a matrix (3, 3) that turns or mirrors, 1 or -1: its sign is what is asked for."""
    a, b = M[1, 1] * M[2, 2] - M[1, 2] * M[2, 1], M[1, 0] * M[2, 2] - M[1, 2] * M[2, 0]
    return M[0, 0] * a - M[0, 1] * b + M[0, 2] * (M[1, 0] * M[2, 1] - M[1, 1] * M[2, 0])
