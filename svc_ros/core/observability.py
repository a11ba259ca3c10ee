"""What the agreeing surface of two scans says about a pose: its covariance, and the direction it says least about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import placement_kernels
from svc_ros.core.config import SightViewConfig
from svc_ros.core.decision_config import CovarianceConfig
from svc_ros.core.neighbours import nearest_grid
from svc_ros.core.scan import Array, PreparedScan


@dataclass(frozen=True, eq=False)
class SurfaceContact:
    """Point-to-plane constraints between a placed source and the target.

    points: (K, 3) [m] placed source points; normals: (K, 3) of the target surface they lie on; residuals: (K,) [m].
    """

    points: Array
    normals: Array
    residuals: Array

    def information(self) -> Array:
        """Sum of J^T J (6, 6), J = [n, p x n]: translation, then rotation about the target's origin."""
        jacobian = np.hstack((self.normals, np.cross(self.points, self.normals)))
        return np.asarray(jacobian.T @ jacobian)

    def weakest_direction(self) -> tuple[Array, float]:
        """Unit direction (3,) along which the surfaces resist a shift least, and how much (0: none, 1/3: evenly)."""
        strength, axes = self._resistance()
        return axes[0], float(strength[0])

    def weak_directions(self, limit: float) -> Array:
        """The weakest direction and every further one that resists less than `limit`, (D, 3)."""
        strength, axes = self._resistance()
        return np.asarray(axes[: max(1, int((strength < limit).sum()))])

    def _resistance(self) -> tuple[Array, Array]:
        """Resistance (3,) ascending and unit directions (3, 3) by rows, each with its largest entry positive."""
        strength, axes = np.linalg.eigh(self.normals.T @ self.normals / max(len(self.normals), 1))
        rows = axes.T
        largest = rows[np.arange(3), np.abs(rows).argmax(1)]
        return np.maximum(strength, 0.0), rows * np.where(largest < 0, -1.0, 1.0)[:, None]

    def covariance(self, config: CovarianceConfig) -> Array:
        """Covariance (6, 6) of the pose: x y z [m], rotations about x y z [rad], left perturbation, target frame.

        Neighbouring points of one surface share their errors, so only one in `points_per_constraint` counts. A floor
        stands for what the residuals do not show: sensor calibration, motion within a sweep.
        """
        variance = float(np.mean(np.square(self.residuals))) if len(self.residuals) else 1.0
        ridge = np.diag([1.0] * 3 + [1.0] * 3)  # keeps directions without any constraint finite
        information = self.information() / config.points_per_constraint / max(variance, 1e-8)
        floor = np.diag([config.floor_translation_m**2] * 3 + [np.radians(config.floor_rotation_deg) ** 2] * 3)
        covariance = np.linalg.inv(information + ridge) + floor
        return np.asarray(0.5 * (covariance + covariance.T))


def find_contact(
    source: PreparedScan, target: PreparedScan, T_target_source: Array, config: SightViewConfig
) -> SurfaceContact:
    """Source points that lie on target surface facing the same way, with the planes they lie on."""
    points, normals, residuals = np.empty_like(source.points), np.empty_like(source.points), np.empty(len(source))
    num = placement_kernels.pick_contact(
        np.ascontiguousarray(T_target_source), source.points, source.normals, target.points, target.normals,
        nearest_grid(target, config.tolerance_m).tables, np.array([config.tolerance_m, config.same_side_cosine]),
        points, normals, residuals,
    )  # fmt: skip
    return SurfaceContact(points[:num], normals[:num], residuals[:num])


def shift(T_target_source: Array, direction: Array, distance_m: float) -> Array:
    """The pose (4, 4), moved along a direction (3,) of the target frame."""
    moved = np.array(T_target_source, np.float64)
    moved[:3, 3] += distance_m * direction
    return moved
