"""Point-to-plane ICP (Levenberg-Marquardt), compiled by numba; no GIL, no state. Twin in test/reference.py."""

from __future__ import annotations

import numpy as np
from numba import njit

from svc_ros.core.nearest_kernels import find_nearest
from svc_ros.core.placement_kernels import move

_jit = njit(nogil=True, cache=True, error_model="numpy")

_FIRST_DAMPING, _DAMPING_FACTOR, _TRIALS = 1e-3, 10.0, 10
_SMALL_SHIFT, _SMALL_TURN = 2e-3, 4e-4  # a step of less [m], [rad] a metre of the radius ends the search


@_jit
def align(T, source, normals, target, radius, grid, rounds):  # type: ignore[no-untyped-def]
    """Move the pose T (4, 4) in place; returns how many rounds it took.

    Least squares of n . (p - q) over source points p (M, 3), placed by T, and the target points q (N, 3) nearest to
    them within the radius, n (N, 3) their normals; matched anew in every round. grid: the tables of a NearestGrid.
    """
    shape, low, first, starts, blocks, names = grid
    placed, nearest = np.empty_like(source), np.empty(len(source), np.int64)
    system, step, moved = np.empty((6, 7)), np.empty(6), np.empty((4, 4))
    damping = _FIRST_DAMPING
    for done in range(rounds):
        move(T, source, placed)
        find_nearest(placed, radius, shape, low, first, starts, blocks, names, nearest)
        error = _sum_up(placed, nearest, target, normals, system)
        better = False
        for _ in range(_TRIALS):
            if not _solve(system, damping, step):
                return done + 1
            _move(step, T, moved)
            if _error(moved, source, nearest, target, normals) <= error:
                better = True
                break
            damping *= _DAMPING_FACTOR
        if not better:
            return done + 1
        damping /= _DAMPING_FACTOR
        T[:] = moved
        if _length(step[:3]) <= _SMALL_SHIFT * radius and _length(step[3:]) <= _SMALL_TURN * radius:
            return done + 1
    return rounds


@_jit
def _sum_up(placed, nearest, target, normals, system):  # type: ignore[no-untyped-def]
    """system (6, 7): normal equations J^T J | -J^T r, J = [n, p x n]; returns the sum of squared residuals r."""
    system[:] = 0.0
    error = 0.0
    row = np.empty(7)
    for m in range(placed.shape[0]):
        j = nearest[m]
        if j < 0:
            continue
        x, y, z = placed[m, 0], placed[m, 1], placed[m, 2]
        a, b, c = normals[j, 0], normals[j, 1], normals[j, 2]
        residual = a * (x - target[j, 0]) + b * (y - target[j, 1]) + c * (z - target[j, 2])
        row[0], row[1], row[2] = a, b, c
        row[3], row[4], row[5] = y * c - z * b, z * a - x * c, x * b - y * a
        row[6] = -residual
        error += residual * residual
        for k in range(6):
            for n in range(k, 7):
                system[k, n] += row[k] * row[n]
    return error


@_jit
def _error(T, source, nearest, target, normals):  # type: ignore[no-untyped-def]
    error = 0.0
    for m in range(source.shape[0]):
        j = nearest[m]
        if j < 0:
            continue
        x, y, z = source[m, 0], source[m, 1], source[m, 2]
        residual = 0.0
        for k in range(3):
            placed = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]
            residual += normals[j, k] * (placed - target[j, k])
        error += residual * residual
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
    moved[:] = T
    for n in range(4):
        u, v, w = T[0, n], T[1, n], T[2, n]
        cu, cv, cw = y * w - z * v, z * u - x * w, x * v - y * u
        moved[0, n] = u + sine * cu + bend * (y * cw - z * cv)
        moved[1, n] = v + sine * cv + bend * (z * cu - x * cw)
        moved[2, n] = w + sine * cw + bend * (x * cv - y * cu)
    for k in range(3):
        moved[k, 3] += step[k]


@_jit
def _length(vector):  # type: ignore[no-untyped-def]
    return np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
