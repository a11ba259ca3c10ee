"""One scan placed in the other's frame: what of the observer's surface does each of its points lie on?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import SightViewConfig
from svc_ros.core.kernels import placement as placement_kernels
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.scans.neighbours import nearest_grid

Shares = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Placement:
    """The other scan in the observer's frame, by a pose (4, 4).

    nearest: (M,) the observer's point that each of the other's lies on, -1 where it lies on none; num_near, num_same,
    num_opposed, num_tight: points with the observer's surface within the tolerance; with surface that faces the same
    way; the opposite way; and, facing the same way, within a quarter of the tolerance;
    plane_sums: (6,) xx, xy, xz, yy, yz, zz of the observer's normals, summed over those that face the same way.
    """

    T_observer_other: Array
    other: PreparedScan
    nearest: NDArray[np.int32]
    num_near: int
    num_same: int
    num_opposed: int
    num_tight: int
    plane_sums: tuple[float, ...]

    def shares(self) -> Shares:
        """Overlap, oriented overlap, opposed and constraint ratio; weakest constraint and tight ratio."""
        weakest, middle, _ = eigenvalues(self.plane_sums)
        num, same = len(self.other), max(self.num_same, 1)
        return (
            self.num_near / num, self.num_same / num, self.num_opposed / num, max(middle, 0.0) / num,
            max(weakest, 0.0) / same, self.num_tight / same,
        )  # fmt: skip


def eigenvalues(sums: tuple[float, ...]) -> tuple[float, float, float]:
    """Of the symmetric matrix with these xx, xy, xz, yy, yz, zz, ascending; to a few roundings of the largest.

    The roots of its characteristic polynomial by the cosine of a third of an angle: many times quicker for one matrix
    than a library's call.
    """
    xx, xy, xz, yy, yz, zz = sums
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread == 0.0:
        return mean, mean, mean
    half_det = 0.5 * (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / spread**3
    angle = math.acos(min(max(half_det, -1.0), 1.0)) / 3.0
    largest = mean + 2.0 * spread * math.cos(angle)
    smallest = mean + 2.0 * spread * math.cos(angle + 2.0 * math.pi / 3.0)
    return smallest, 3.0 * mean - largest - smallest, largest


def place(observer: PreparedScan, other: PreparedScan, T_observer_other: Array, config: SightViewConfig) -> Placement:
    """Place the other scan by a pose (4, 4) and find the surface under every point."""
    T, nearest, sums = np.ascontiguousarray(T_observer_other), np.empty(len(other), np.int32), np.empty(10)
    placement_kernels.split(
        T, other.points, other.normals, observer.points, observer.normals,
        nearest_grid(observer, config.tolerance_m).tables, (config.tolerance_m, config.same_side_cosine),
        nearest, sums,
    )  # fmt: skip
    near, same, opposed, tight, *planes = sums.tolist()
    return Placement(T, other, nearest, int(near), int(same), int(opposed), int(tight), tuple(planes))
