"""How a sensor moves while it takes one scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array


@dataclass(frozen=True)
class SensorMotion:
    """Constant motion of a sensor, told in its own frame, for the time of one scan.

    velocity_mps: (3,) [m/s]; turn_rate_dps: (3,) about the sensor's axes [deg/s]; stamp_share: where within the scan
    its stamp lies, 0 at the first firing and 1 at the last.
    """

    velocity_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_rate_dps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stamp_share: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([*self.velocity_mps, *self.turn_rate_dps]).all() or not 0.0 <= self.stamp_share <= 1.0:
            raise ConfigError(f"sensor motion: expected finite rates and stamp_share in [0, 1], found {self}")

    def offsets_s(self, firing_times_s: Array) -> Array:
        """Times (N,) of firings relative to the stamp [s], from those relative to the first one."""
        return firing_times_s - self.stamp_share * float(firing_times_s.max(initial=0.0))

    def poses(self, offset_s: Array) -> tuple[Array, Array]:
        """Rotations (N, 3, 3) and places (N, 3) [m] of the sensor at times (N,) [s], in its own frame at time zero."""
        offset = np.asarray(offset_s, np.float64)
        rate = np.radians(self.turn_rate_dps)
        R = Rotation.from_rotvec(offset[:, None] * rate).as_matrix()
        return R, self._travel(offset, rate)

    def _travel(self, offset: Array, rate: Array) -> Array:
        """Integral of the turning velocity from zero to each time (N,), (N, 3) [m]."""
        v, speed = np.array(self.velocity_mps), float(np.linalg.norm(rate))
        straight = np.outer(offset, v)
        if speed < 1e-9:
            return straight
        axis = rate / speed
        angle = speed * offset
        along, once = axis * (axis @ v), np.cross(axis, v)
        across = v - along
        arc = np.outer(np.sin(angle), across) + np.outer(1.0 - np.cos(angle), once)
        return np.asarray(np.outer(offset, along) + arc / speed)
