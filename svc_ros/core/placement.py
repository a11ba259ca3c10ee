"""One scan placed in the other's frame: what of the observer's surface does each of its points lie on?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import placement_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.neighbours import nearest_grid
from svc_ros.core.scan import Array, IndexArray, PreparedScan


@dataclass(frozen=True, eq=False)
class Placement:
    """The other scan in the observer's frame.

    alone, alone_normals: (A, 3) [m], unit, the placed points that lie on nothing of the observer's; alone_idx: (A,)
    their indices; num_points: of the whole other scan; num_near, num_same, num_opposed, num_tight: its points with the
    observer's surface within the tolerance; with surface that faces the same way; the opposite way; and, facing the
    same way, within a quarter of the tolerance;
    plane_sums: (3, 3) outer products of the observer's normals, summed over those that face the same way.
    """

    alone: Array
    alone_normals: Array
    alone_idx: IndexArray
    num_points: int
    num_near: int
    num_same: int
    num_opposed: int
    num_tight: int
    plane_sums: Array

    def shares(self) -> Array:
        """(6,): overlap, oriented overlap, opposed and constraint ratio; weakest constraint and tight ratio."""
        weakest, middle, _ = np.maximum(np.linalg.eigvalsh(self.plane_sums), 0.0)
        of_all = np.array([self.num_near, self.num_same, self.num_opposed, middle]) / self.num_points
        return np.concatenate((of_all, np.array([weakest, self.num_tight]) / max(self.num_same, 1)))


def place(observer: PreparedScan, other: PreparedScan, T_observer_other: Array, config: SightViewConfig) -> Placement:
    """Place the other scan by a pose (4, 4) and find the surface under every point."""
    alone, alone_normals = np.empty_like(other.points), np.empty_like(other.normals)
    names, sums = np.empty(len(other), np.int64), np.empty(10)
    num = placement_kernels.split(
        np.ascontiguousarray(T_observer_other), other.points, other.normals, observer.points, observer.normals,
        nearest_grid(observer, config.tolerance_m).tables, np.array([config.tolerance_m, config.same_side_cosine]),
        alone, alone_normals, names, sums,
    )  # fmt: skip
    near, same, opposed, tight = sums[:4].astype(np.int64).tolist()
    planes = sums[[4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(3, 3)
    return Placement(
        alone[:num], alone_normals[:num], names[:num], len(other), near, same, opposed, tight, planes
    )  # fmt: skip
