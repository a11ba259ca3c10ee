"""One scan placed in the other's frame: what of the observer's surface does each of its points lie on?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import neighbour_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.neighbours import radius_grid
from svc_ros.core.scan import Array, IndexArray, PreparedScan


@dataclass(frozen=True, eq=False)
class Placement:
    """The other scan in the observer's frame.

    points, normals: (M, 3) [m], unit; nearest: (M,) index of the observer's nearest point within the tolerance, or -1;
    num_near, num_same, num_opposed, num_tight: placed points with such a neighbour; whose surface faces the same way;
    the opposite way; and, facing the same way, within a quarter of the tolerance of the observer's surface;
    plane_sums: (3, 3) outer products of the observer's normals, summed over those that face the same way.
    """

    points: Array
    normals: Array
    nearest: IndexArray
    num_near: int
    num_same: int
    num_opposed: int
    num_tight: int
    plane_sums: Array

    def shares(self) -> Array:
        """(6,): overlap, oriented overlap, opposed and constraint ratio; weakest constraint and tight ratio."""
        weakest, middle, _ = np.maximum(np.linalg.eigvalsh(self.plane_sums), 0.0)
        of_all = np.array([self.num_near, self.num_same, self.num_opposed, middle]) / len(self.points)
        return np.concatenate((of_all, np.array([weakest, self.num_tight]) / max(self.num_same, 1)))


def place(observer: PreparedScan, other: PreparedScan, T_observer_other: Array, config: SightViewConfig) -> Placement:
    """Place the other scan by a pose (4, 4) and find the surface under every point."""
    points, normals = np.empty_like(other.points), np.empty_like(other.normals)
    nearest, sums = np.empty(len(other), np.int64), np.empty(10)
    neighbour_kernels.place(np.ascontiguousarray(T_observer_other), other.points, other.normals, points, normals)
    grid = radius_grid(observer, config.tolerance_m)
    neighbour_kernels.find_nearest(points, config.tolerance_m, *grid.tables, nearest)
    neighbour_kernels.sum_up(
        points, normals, nearest, observer.points, observer.normals, config.tolerance_m, config.same_side_cosine, sums
    )
    near, same, opposed, tight = sums[:4].astype(np.int64).tolist()
    planes = sums[[4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(3, 3)
    return Placement(points, normals, nearest, near, same, opposed, tight, planes)
