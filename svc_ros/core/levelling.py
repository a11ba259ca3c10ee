"""Which way is up, and how high above the ground stands the sensor? Seen from the ground itself."""

from __future__ import annotations

import numpy as np

from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import make_pose, turn_onto

_CONES = (0.8, 0.9, 0.95, 0.97)  # cosines: the ground lies within 37 deg of level, then within what is found
_MIN_GROUND, _MIN_GROUND_SHARE = 50, 0.03  # points of a scan that face up from below the sensor
_UP = np.array([0.0, 0.0, 1.0])


def find_level(scan: PreparedScan) -> Array | None:
    """T_level_scan (4, 4): z up, the ground about the sensor at z = 0 and the sensor above the origin.

    None where the scan sees too little ground, or stands steeper than about 35 deg. Found once a scan.
    """
    if "level" not in scan.memo:
        scan.memo["level"] = _find_level(scan)
    level: Array | None = scan.memo["level"]
    return level


def _find_level(scan: PreparedScan) -> Array | None:
    from_sensor, up = scan.points - scan.sensor_origin, _UP
    for cosine in _CONES:
        ground = (scan.normals @ up > cosine) & (from_sensor @ up < 0.0)
        if np.count_nonzero(ground) < max(_MIN_GROUND, _MIN_GROUND_SHARE * len(scan)):
            return None
        mean = scan.normals[ground].mean(0)
        up = mean / np.linalg.norm(mean)
    height = from_sensor[ground] @ up
    level = np.linalg.norm(from_sensor[ground] - height[:, None] * up, axis=1)
    ground_z = float(np.median(height[level <= np.median(level)]))
    R = turn_onto(up, _UP)
    return make_pose(R, -R @ scan.sensor_origin - ground_z * _UP)
