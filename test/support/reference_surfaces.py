"""Slow twins of the surface kernels: normals and FPFH by the definitions, all pairs, float64, point by point."""

from __future__ import annotations

import numpy as np


def surroundings(points: np.ndarray, i: int, radius: float, most: int) -> np.ndarray:
    """Indices of the `most` nearest points nearer than the radius, point i itself among them and first."""
    distance = np.linalg.norm(points - points[i], axis=1)
    distance[i] = -1.0
    order = np.argsort(distance, kind="stable")[:most]
    return order[distance[order] < radius]


def fitted_normals(points: np.ndarray, radius: float, most: int) -> np.ndarray:
    """Direction (N, 3) of least spread of every point's surroundings; NaN where they are fewer than three points."""
    normals = np.full((len(points), 3), np.nan)
    for i in range(len(points)):
        near = points[surroundings(points, i, radius, most)]
        if len(near) >= 3:
            normals[i] = np.linalg.eigh(np.cov(near.T))[1][:, 0]
    return normals


def pair_features(p: np.ndarray, n: np.ndarray, q: np.ndarray, m: np.ndarray) -> tuple[float, float, float]:
    """Angle, tilt and lean of two points and their normals (Darboux frame on the normal nearer to their line)."""
    d = (q - p) / np.linalg.norm(q - p)
    if abs(n @ d) < abs(m @ d):
        n, m, d = m, n, -d
    v = np.cross(d, n)
    if np.linalg.norm(v) < 1e-9:
        return 0.0, 0.0, 0.0
    v /= np.linalg.norm(v)
    return float(np.arctan2(np.cross(n, v) @ m, n @ m)), float(v @ m), float(n @ d)


def own_histogram(points: np.ndarray, normals: np.ndarray, i: int, near: np.ndarray) -> np.ndarray:
    """Histogram (33,) of the pair features of point i, each third sums to 100."""
    histogram = np.zeros(33)
    for j in near[1:]:
        angle, tilt, lean = pair_features(points[i], normals[i], points[j], normals[j])
        for third, share in enumerate(((angle / np.pi + 1) / 2, (tilt + 1) / 2, (lean + 1) / 2)):
            histogram[11 * third + min(int(11 * share), 10)] += 100.0 / (len(near) - 1)
    return histogram


def fpfh(points: np.ndarray, normals: np.ndarray, radius: float, most: int) -> np.ndarray:
    """FPFH (N, 33), rows of unit length, zeros where nothing is near."""
    near = [surroundings(points, i, radius, most) for i in range(len(points))]
    own = np.array([own_histogram(points, normals, i, near[i]) for i in range(len(points))])
    rows = np.zeros_like(own)
    for i, others in enumerate(near):
        if len(others) < 2:
            continue
        weights = 1.0 / np.square(points[others[1:]] - points[i]).sum(1)
        thirds = (weights @ own[others[1:]]).reshape(3, 11)
        rows[i] = own[i] + (100.0 * thirds / thirds.sum(1, keepdims=True)).ravel()
        rows[i] /= np.linalg.norm(rows[i])
    return rows
