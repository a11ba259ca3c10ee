"""What the agreeing surface of two scans says about a pose: its covariance, and the direction it says least about."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from svc_ros.core.config import SightViewConfig
from svc_ros.core.decision_config import CovarianceConfig
from svc_ros.core.kernels import placement as placement_kernels
from svc_ros.core.kernels import plane as plane_kernels
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import apply, rotate
from svc_ros.core.sight.placement import Placement

_FOR_EXTENT = 1000


@dataclass(frozen=True, eq=False)
class SurfaceContact:
    """Point-to-plane constraints between a placed source and the target, summed up.

    information: (6, 6) sum of J^T J, J = [n, p x n], p the placed source point and n the normal of the target surface
    that it lies on: translation [m], then rotation [rad] about the target's origin; num_points: how many;
    sum_squared_m2: of their residuals; middle: (3,) [m], mean of some of the points; lever_m2: (3, 3), v' lever_m2 v is
    their mean squared distance from the line through the middle along a unit vector v.
    """

    information: Array
    num_points: int
    sum_squared_m2: float
    middle: Array = field(default_factory=lambda: np.zeros(3))
    lever_m2: Array = field(default_factory=lambda: np.zeros((3, 3)))

    @property
    def variance_m2(self) -> float:
        """Mean squared residual; 1 without any."""
        return self.sum_squared_m2 / self.num_points if self.num_points else 1.0

    def weakest_direction(self) -> tuple[Array, float]:
        """Unit direction (3,) along which the surfaces resist a shift least, and how much (0: none, 1/3: evenly)."""
        strength, axes = self._resistance()
        return axes[0], float(strength[0])

    def axes(self) -> Array:
        """Main directions of the agreeing surfaces, (3, 3) unit by rows, the one that is resisted least first."""
        return self._resistance()[1]

    def weak_directions(self, limit: float, at_least: int = 1) -> Array:
        """The directions that resist less than `limit`, or the `at_least` weakest ones where those are more, (D, 3)."""
        strength, axes = self._resistance()
        return np.asarray(axes[: max(at_least, int((strength < limit).sum()))])

    def _resistance(self) -> tuple[Array, Array]:
        """Resistance (3,) ascending and unit directions (3, 3) by rows, each with its largest entry positive."""
        axes = np.empty((3, 3))
        strength = plane_kernels.find_axes(self.information[:3, :3] / max(self.num_points, 1), axes)
        for axis in axes:
            axis *= math.copysign(1.0, max(axis.tolist(), key=abs))
        return np.maximum(strength, 0.0), axes

    def about_the_middle(self) -> Array:
        """The information (6, 6) with rotations about the middle of the points, not about the target's origin."""
        x, y, z = self.middle
        lever = np.eye(6)
        lever[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        return np.asarray(lever @ self.information @ lever.T)

    def covariance(self, config: CovarianceConfig) -> Array:
        """Covariance (6, 6) of the pose: x y z [m], rotations about x y z [rad], left perturbation, target frame.

        Neighbouring points of one surface share their errors, so only one in `points_per_constraint` counts. A floor
        stands for what the residuals do not show: sensor calibration, motion within a sweep.
        """
        information = self.information / config.points_per_constraint / max(self.variance_m2, 1e-8)
        floor = np.diag([config.floor_translation_m**2] * 3 + [math.radians(config.floor_rotation_deg) ** 2] * 3)
        covariance = np.linalg.inv(information + np.eye(6)) + floor  # directions without any constraint stay finite
        return np.asarray(0.5 * (covariance + covariance.T))


def find_contact(target: PreparedScan, placement: Placement, config: SightViewConfig) -> SurfaceContact:
    """Of the source points, placed in the target's frame, those on target surface that faces the same way."""
    system = np.empty((6, 7))
    num, squared = placement_kernels.sum_contact(
        placement.T_observer_other, placement.other.points, placement.other.normals, placement.nearest,
        target.points, target.normals, config.same_side_cosine, system,
    )  # fmt: skip
    upper = np.triu(system[:, :6])
    return SurfaceContact(upper + np.triu(upper, 1).T, num, squared, *_extent(target, placement, config))


def _extent(target: PreparedScan, placement: Placement, config: SightViewConfig) -> tuple[Array, Array]:
    """Middle and lever of the points that touch; of at most about a thousand of them, since both are but a scale."""
    near = np.flatnonzero(placement.nearest >= 0)
    some, T = near[:: max(1, len(near) // _FOR_EXTENT)], placement.T_observer_other
    normals = rotate(T, placement.other.normals[some])
    facing = np.einsum("ij,ij->i", normals, target.normals[placement.nearest[some]])
    return middle_and_lever(apply(T, placement.other.points[some[facing > config.same_side_cosine]]))


def middle_and_lever(points: Array) -> tuple[Array, Array]:
    """Mean (3,) of points (N, 3), and `lever_m2` (3, 3) of SurfaceContact; zeros without any."""
    if len(points) == 0:
        return np.zeros(3), np.zeros((3, 3))
    middle = points.mean(0)
    scatter = np.einsum("ij,ik->jk", points - middle, points - middle) / len(points)
    return middle, np.trace(scatter) * np.eye(3) - scatter


def shift(T_target_source: Array, direction: Array, distance_m: float) -> Array:
    """The pose (4, 4), moved along a direction (3,) of the target frame."""
    moved = np.array(T_target_source, np.float64)
    moved[:3, 3] += distance_m * direction
    return moved
