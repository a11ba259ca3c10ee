"""Point-to-plane ICP (Levenberg-Marquardt), compiled by numba; no GIL, no state. Twin in test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.nearest import find_nearest
from svc_ros.core.kernels.placement import AT_ONCE, move
from svc_ros.core.kernels.plane import fill_rows, sum_squared, sum_up

_jit = kernel()

_FIRST_DAMPING, _DAMPING_FACTOR, _TRIALS = 1e-3, 10.0, 10
_SMALL_SHIFT, _SMALL_TURN = 2e-3, 4e-4  # a step of less [m], [rad] a metre of the radius ends the search


@_jit
def align(T, source, normals, target, radius, grid, rounds):  # type: ignore[no-untyped-def]
    """Move the pose T (4, 4) in place; returns how many rounds it took.

    Least squares of n . (p - q) over source points p (M, 3), placed by T, and the target points q (N, 3) nearest to
    them within the radius, n (N, 3) their normals; matched anew in every round. grid: the tables of a NearestGrid.
    """
    shape, spans, starts, blocks, names = grid
    placed, nearest = np.empty_like(source), np.empty(len(source), np.int32)
    pairs, rows = np.empty((9, len(source))), np.empty((7, AT_ONCE))
    system, step, moved = np.empty((6, 7)), np.empty(6), np.empty((4, 4))
    damping = _FIRST_DAMPING
    for done in range(rounds):
        move(T, source, placed)
        find_nearest(placed, radius, shape, spans, starts, blocks, names, nearest)
        num = _pair_up(source, nearest, target, normals, pairs)
        error = _sum_up(T, pairs[:, :num], rows, system)
        better = False
        for _ in range(_TRIALS):
            if not _solve(system, damping, step):
                return done + 1
            _move(step, T, moved)
            if sum_squared(moved, pairs[:, :num]) <= error:
                better = True
                break
            damping *= _DAMPING_FACTOR
        if not better:
            return done + 1
        damping /= _DAMPING_FACTOR
        _copy(moved, T)
        if _length(step[:3]) <= _SMALL_SHIFT * radius and _length(step[3:]) <= _SMALL_TURN * radius:
            return done + 1
    return rounds


@_jit
def _pair_up(source, nearest, target, normals, pairs):  # type: ignore[no-untyped-def]
    """pairs (9, M): source point, target point and its normal of each of the P pairs; returns P."""
    num = 0
    for m in range(source.shape[0]):
        if nearest[m] >= 0:
            j = np.uint64(nearest[m])
            for k in range(3):
                pairs[k, num], pairs[3 + k, num], pairs[6 + k, num] = source[m, k], target[j, k], normals[j, k]
            num += 1
    return num


@_jit
def _sum_up(T, pairs, rows, system):  # type: ignore[no-untyped-def]
    """system (6, 7): normal equations of the pairs (9, P); returns the sum of squared residuals. rows: (7, AT_ONCE)."""
    system[:] = 0.0
    error = 0.0
    for begin in range(0, pairs.shape[1], AT_ONCE):
        end = min(begin + AT_ONCE, pairs.shape[1])
        fill_rows(T, pairs[:, begin:end], rows)
        error += sum_up(rows[:, : end - begin], system)
    return error


@_jit
def _solve(system, damping, step):  # type: ignore[no-untyped-def]
    """step (6,): solution of the damped system (6, 7), of which the upper triangle is read; False if it has none."""
    lower = np.zeros((6, 6))  # Cholesky
    for i in range(6):
        for k in range(i + 1):
            rest = system[k, i] + (damping if i == k else 0.0)
            for n in range(k):
                rest -= lower[i, n] * lower[k, n]
            if i > k:
                lower[i, k] = rest / lower[k, k]
            elif rest > 0.0:
                lower[i, i] = np.sqrt(rest)
            else:
                return False
    for i in range(6):
        step[i] = system[i, 6]
        for n in range(i):
            step[i] -= lower[i, n] * step[n]
        step[i] /= lower[i, i]
    for i in range(5, -1, -1):
        for n in range(i + 1, 6):
            step[i] -= lower[n, i] * step[n]
        step[i] /= lower[i, i]
    return True


@_jit
def _move(step, T, moved):  # type: ignore[no-untyped-def]
    """moved (4, 4): T, turned by the rotation vector step[3:] about the origin, then shifted by step[:3]."""
    angle = _length(step[3:])
    x, y, z = step[3], step[4], step[5]
    sine = np.sin(angle) / angle if angle > 1e-12 else 1.0
    bend = (1.0 - np.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    _copy(T, moved)
    for n in range(4):
        u, v, w = T[0, n], T[1, n], T[2, n]
        cu, cv, cw = y * w - z * v, z * u - x * w, x * v - y * u
        moved[0, n] = u + sine * cu + bend * (y * cw - z * cv)
        moved[1, n] = v + sine * cv + bend * (z * cu - x * cw)
        moved[2, n] = w + sine * cw + bend * (x * cv - y * cu)
    for k in range(3):
        moved[k, 3] += step[k]


@_jit
def _copy(pose, into):  # type: ignore[no-untyped-def]
    """Entry by entry (4, 4): whole arrays bring along the message on shapes that differ, long to compile."""
    for i in range(4):
        for j in range(4):
            into[i, j] = pose[i, j]


@_jit
def _length(vector):  # type: ignore[no-untyped-def]
    return np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
