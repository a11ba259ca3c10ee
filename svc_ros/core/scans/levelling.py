"""Which way is up, and how high above the ground stands the sensor? Seen from the ground itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import make_pose, turn_onto

_CONES = (0.8, 0.9, 0.95, 0.97)  # cosines: the ground lies within 37 deg of level, then within what is found
_MIN_GROUND, _MIN_GROUND_SHARE = 50, 0.03  # points of a scan that face up from below the sensor
_SURE_TILT_DEG, _SURE_GROUND_SHARE = 20.0, 0.1
_SURE_BELOW_M, _SURE_BELOW_SHARE = 0.7, 0.05  # next to nothing lies so far below the ground
_WALL_COSINE, _SECTORS = 0.4, 16  # walls that face one way: within two sectors of a circle
_LOWEST = 0.02  # share of the points that lie lower than what stands for the ground
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Level:
    """T_level_scan (4, 4): z up, the ground about the sensor at z = 0 and the sensor above the origin.

    sure: whether it can hardly be a wall that was taken for the ground: nothing lies below, no wall is larger, and the
    sensor stands upright.
    """

    T_level_scan: Array
    sure: bool


def find_level(scan: PreparedScan, z_is_up: bool = False) -> Level | None:
    """None where the scan sees too little ground, or stands steeper than about 35 deg. Found once a scan.

    Where z is known to be up (an IMU, a level mount), it is, and surely; the lowest surface takes the place of ground
    that is not seen.
    """
    key = ("level", z_is_up)
    if key not in scan.memo:
        scan.memo[key] = _trust(scan) if z_is_up else _find_level(scan)
    level: Level | None = scan.memo[key]
    return level


def _find_level(scan: PreparedScan) -> Level | None:
    from_sensor, up = scan.points - scan.sensor_origin, _UP
    for cosine in _CONES:
        ground = (scan.normals @ up > cosine) & (from_sensor @ up < 0.0)
        if not _is_enough(ground):
            return None
        mean = scan.normals[ground].mean(0)
        up = mean / np.linalg.norm(mean)
    ground_z, R = _height(from_sensor[ground], up), turn_onto(up, _UP)
    share, below = float(ground.mean()), float(np.mean(from_sensor @ up < ground_z - _SURE_BELOW_M))
    sure = (
        up[2] >= math.cos(math.radians(_SURE_TILT_DEG)) and share >= _SURE_GROUND_SHARE
        and below <= _SURE_BELOW_SHARE and share >= _largest_wall(scan.normals @ R.T)
    )  # fmt: skip
    return Level(make_pose(R, -R @ scan.sensor_origin - ground_z * _UP), bool(sure))


def _trust(scan: PreparedScan) -> Level:
    from_sensor = scan.points - scan.sensor_origin
    ground = (scan.normals[:, 2] > _CONES[-1]) & (from_sensor[:, 2] < 0.0)
    lowest = float(np.quantile(from_sensor[:, 2], _LOWEST))
    ground_z = _height(from_sensor[ground], _UP) if _is_enough(ground) else lowest
    return Level(make_pose(np.eye(3), -scan.sensor_origin - ground_z * _UP), sure=True)


def _is_enough(ground: NDArray[np.bool_]) -> bool:
    return bool(np.count_nonzero(ground) >= max(_MIN_GROUND, _MIN_GROUND_SHARE * len(ground)))


def _height(ground: Array, up: Array) -> float:
    """Of ground (N, 3) from the sensor, of the nearer half of it [m]."""
    height = ground @ up
    level = np.linalg.norm(ground - height[:, None] * up, axis=1)
    return float(np.median(height[level <= np.median(level)]))


def _largest_wall(normals: Array) -> float:
    """Share of level normals (N, 3) that are upright surface's and face about the same way."""
    upright = normals[np.abs(normals[:, 2]) < _WALL_COSINE]
    azimuth = np.arctan2(upright[:, 1], upright[:, 0])
    sector = np.floor(azimuth / (2.0 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS
    num = np.bincount(sector, minlength=_SECTORS)
    return float((num + np.roll(num, 1)).max() / len(normals))
