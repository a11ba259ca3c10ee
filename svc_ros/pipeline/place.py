"""How a place looks from where the sensor stands, in a few numbers: which places look the same, and turned how far.

Counts of thinned points over rings and sectors around the sensor's vertical axis. A turn about that axis shifts the
sectors, so that one circular correlation tells likeness and turn at once. Cheap (a millisecond a scan, some
microseconds a comparison) and only ever a proposal: what looks alike is judged by sight lines before anything is made
of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.scan import Array, PreparedScan

NUM_RINGS = 20
NUM_SECTORS = 120  # 3 deg each
_REACH = 100.0  # the outermost ring begins so many voxels from the sensor


@dataclass(frozen=True, eq=False)
class PlaceLook:
    """Spectrum (rings, frequencies) of the counts around the sensor, of unit energy; sensor_origin: (3,) [m]."""

    spectrum: NDArray[np.complex128]
    sensor_origin: Array


def look_at_place(scan: PreparedScan) -> PlaceLook:
    """Describe the place of one prepared scan."""
    x, y, _ = (scan.points - scan.sensor_origin).T
    ring = np.floor(np.hypot(x, y) / (_REACH * scan.voxel_size_m) * NUM_RINGS)
    sector = np.floor((np.arctan2(y, x) / (2.0 * np.pi) + 0.5) * NUM_SECTORS).astype(np.int64) % NUM_SECTORS
    cell = np.minimum(ring, NUM_RINGS - 1).astype(np.int64) * NUM_SECTORS + sector
    counts = np.log1p(np.bincount(cell, minlength=NUM_RINGS * NUM_SECTORS)).reshape(NUM_RINGS, NUM_SECTORS)
    counts /= max(float(np.linalg.norm(counts)), 1e-12)
    return PlaceLook(np.fft.rfft(counts, axis=1), scan.sensor_origin)


def compare_places(source: PlaceLook, target: PlaceLook) -> tuple[float, Array]:
    """Likeness in [0, 1], and the turn (4, 4) that puts the source onto the target with both sensors in one spot."""
    likeness = np.fft.irfft((np.conj(source.spectrum) * target.spectrum).sum(0), n=NUM_SECTORS)
    best = int(np.argmax(likeness))
    R = Rotation.from_euler("z", 2.0 * np.pi * best / NUM_SECTORS).as_matrix()
    T = se3.make_pose(R, target.sensor_origin - R @ source.sensor_origin)
    return min(max(float(likeness[best]), 0.0), 1.0), T
