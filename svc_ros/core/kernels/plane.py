"""Normal equations of point-to-plane residuals, compiled by numba; no GIL. Twins: test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel(fastmath={"reassoc", "nsz"})  # sums of several at once

_SWEEPS = 8  # each doubles the digits


@_jit
def fill_rows(T, pairs, rows):  # type: ignore[no-untyped-def]
    """rows (7, P): J = [n, p x n] and the negative residual -r of every pair.

    pairs (9, P): point, plane point and the plane's normal n; p: the point, placed by T (4, 4); r: n . (p - q).
    """
    for m in range(pairs.shape[1]):
        x, y, z = pairs[0, m], pairs[1, m], pairs[2, m]
        px = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        py = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        pz = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        a, b, c = pairs[6, m], pairs[7, m], pairs[8, m]
        rows[0, m], rows[1, m], rows[2, m] = a, b, c
        rows[3, m], rows[4, m], rows[5, m] = py * c - pz * b, pz * a - px * c, px * b - py * a
        rows[6, m] = a * (pairs[3, m] - px) + b * (pairs[4, m] - py) + c * (pairs[5, m] - pz)


@_jit
def sum_up(rows, system):  # type: ignore[no-untyped-def]
    """Add the normal equations J^T J | -J^T r to the upper triangle of system (6, 7); returns the sum of r^2."""
    for k in range(7):
        for n in range(k, 7):
            total = 0.0
            for m in range(rows.shape[1]):
                total += rows[k, m] * rows[n, m]
            if k < 6:
                system[k, n] += total
    return total


@_jit
def sum_squared(T, pairs):  # type: ignore[no-untyped-def]
    """Sum of squared residuals of the pairs (9, P) by the pose T (4, 4)."""
    error = 0.0
    for m in range(pairs.shape[1]):
        x, y, z = pairs[0, m], pairs[1, m], pairs[2, m]
        residual = pairs[6, m] * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3] - pairs[3, m])
        residual += pairs[7, m] * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3] - pairs[4, m])
        residual += pairs[8, m] * (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3] - pairs[5, m])
        error += residual * residual
    return error


@_jit
def find_axes(A, axes):  # type: ignore[no-untyped-def]
    """Eigenvalues of a symmetric matrix (3, 3), ascending, and unit eigenvectors, the rows of axes (3, 3).

    By rotations (Jacobi). A is overwritten.
    """
    V = np.zeros((3, 3))
    V[0, 0] = V[1, 1] = V[2, 2] = 1.0
    for _ in range(_SWEEPS):
        for i in range(2):
            for j in range(i + 1, 3):
                if A[i, j] == 0.0:
                    continue
                ratio = (A[j, j] - A[i, i]) / (2.0 * A[i, j])
                tangent = (1.0 if ratio >= 0.0 else -1.0) / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
                cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(3):
                    A[k, i], A[k, j] = cosine * A[k, i] - sine * A[k, j], sine * A[k, i] + cosine * A[k, j]
                for k in range(3):
                    A[i, k], A[j, k] = cosine * A[i, k] - sine * A[j, k], sine * A[i, k] + cosine * A[j, k]
                    V[k, i], V[k, j] = cosine * V[k, i] - sine * V[k, j], sine * V[k, i] + cosine * V[k, j]
    values = np.empty(3)
    for n in range(3):  # by insertion; of equal ones the first
        place = n
        while place > 0 and A[n, n] < values[place - 1]:
            values[place] = values[place - 1]
            for k in range(3):
                axes[place, k] = axes[place - 1, k]
            place -= 1
        values[place] = A[n, n]
        for k in range(3):
            axes[place, k] = V[k, n]
    return values
