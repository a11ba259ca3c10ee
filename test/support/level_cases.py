"""Prepared scans of places with level ground, seen by a sensor that stands as told; surfaces and normals are exact."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from mini_data import POSES, scan_room
from scan_cases import room_config
from scipy.spatial.transform import Rotation
from simulated_scans import Place, scan_at

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.core.se3 import apply, invert, make_pose, rotate

EYE_M = 1.8
ROOM_EYE_M = 1.2


def tilt(deg: float, azimuth_deg: float = 40.0, origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Pose (4, 4) that tilts by `deg` about a level axis and moves the sensor to `origin`."""
    azimuth = np.radians(azimuth_deg)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return make_pose(Rotation.from_rotvec(np.radians(deg) * axis).as_matrix(), origin)


def plane(middle: tuple[float, ...], along: tuple[float, ...], across: tuple[float, ...]) -> np.ndarray:
    """Points (N, 3) half a metre apart on a rectangle that reaches so far from its middle, four ways."""
    along_array, across_array = np.asarray(along, float), np.asarray(across, float)
    u, v = (np.arange(-edge, edge + 0.01, 0.5) / edge for edge in map(np.linalg.norm, (along_array, across_array)))
    u, v = (values.reshape(-1, 1) for values in np.meshgrid(u, v))
    return np.asarray(middle) + u * along_array + v * across_array


def seen(surfaces: dict[tuple[float, float, float], list[np.ndarray]], T: np.ndarray) -> PreparedScan:
    """Surfaces by their normal, in the level frame of the sensor, seen by one that stands as T (4, 4) tells."""
    points = np.concatenate([plane for planes in surfaces.values() for plane in planes])
    normals = np.concatenate([np.tile(n, (sum(map(len, planes)), 1)) for n, planes in surfaces.items()])
    return PreparedScan(apply(T, points), rotate(T, normals), T[:3, 3], 0.5)


def field(T: np.ndarray) -> PreparedScan:
    """Nothing but level ground."""
    return seen({(0, 0, 1): [plane((0, 0, -EYE_M), (30, 0, 0), (0, 20, 0))]}, T)


def street(T: np.ndarray, below_m: float = 0.0, walls_m: float = 4.0) -> PreparedScan:
    """Ground between two rows of house fronts of that height; below_m: of a ditch beside, under the ground."""
    fronts = [plane((x, 0, 0.5 * walls_m - EYE_M), (7, 0, 0), (0, 0, 0.5 * walls_m)) for x in (-20.0, 0.0, 18.0)]
    ground = [plane((0, 0, -EYE_M), (30, 0, 0), (0, 10, 0))]
    if below_m:
        ground.append(plane((0, 15, -EYE_M - below_m), (30, 0, 0), (0, 4, 0)))
    return seen(
        {
            (0, 0, 1): ground,
            (0, -1, 0): [front - (0.0, -10.0, 0.0) for front in fronts],
            (0, 1, 0): [front * (-1.0, 1.0, 1.0) - (0.0, 10.0, 0.0) for front in fronts],
        },
        T,
    )


def room(T: np.ndarray, pose: int = 1) -> PreparedScan:
    """The furnished room from a pose of mini_data, prepared as a scan with noise is."""
    return prepare(Scan(apply(T, scan_room(POSES[pose], seed=pose)), sensor_origin=T[:3, 3]), room_config())


@lru_cache(maxsize=32)
def simulated(place: Place, preset_name: str, tilt_deg: float = 0.0, azimuth_deg: float = 0.0) -> PreparedScan:
    """A simulated scan, tilted."""
    T = tilt(tilt_deg, azimuth_deg)
    return prepare(Scan(apply(T, scan_at(place)[0].points)), preset(preset_name))


def tilted_pair(places: tuple[Place, Place], preset_name: str) -> tuple[PreparedScan, PreparedScan, np.ndarray]:
    """Source and target, both tilted a little and each another way, and the pose between them."""
    tilts = (4.0, 70.0), (6.0, -50.0)
    source, target = (simulated(place, preset_name, *how) for place, how in zip(places, tilts, strict=True))
    between = invert(scan_at(places[1])[1]) @ scan_at(places[0])[1]
    return source, target, tilt(*tilts[1]) @ between @ se3.invert(tilt(*tilts[0]))
