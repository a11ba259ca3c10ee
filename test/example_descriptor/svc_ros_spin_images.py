"""Spin images (Johnson and Hebert, 1999): where the neighbours of a point lie, seen from its normal."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from svc_ros import Config, Description, PreparedScan

RADIUS_VOXELS, NEIGHBOURS, BINS, PLACES = 10.0, 300, 8, 5000


def describe(scan: PreparedScan, config: Config) -> Description:
    """A histogram (BINS x BINS) of distance from the normal's line and height along it, for up to about PLACES points.

    Square roots of shares are compared, so that crowded cells do not decide alone.
    """
    radius = RADIUS_VOXELS * config.preprocess.voxel_size_m
    chosen = np.arange(0, len(scan), max(1, len(scan) // PLACES))
    points, normals = scan.points[chosen], scan.normals[chosen]
    distance, nearest = cKDTree(scan.points).query(points, NEIGHBOURS, distance_upper_bound=radius)
    place, column = np.nonzero(np.isfinite(distance) & (distance > 0))
    offset = scan.points[nearest[place, column]] - points[place]
    height = np.einsum("ij,ij->i", offset, normals[place])
    aside = np.sqrt(np.maximum((offset**2).sum(1) - height**2, 0))
    row = np.minimum(BINS * aside / radius, BINS - 1).astype(int)
    cell = np.minimum(BINS * (height / radius + 1) / 2, BINS - 1).astype(int)
    counts = np.bincount((place * BINS + row) * BINS + cell, minlength=len(chosen) * BINS**2)
    return Description(points, np.sqrt(counts.reshape(len(chosen), -1)))
