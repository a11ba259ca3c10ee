"""What the numbers of a scan say of how it was made, where that keeps it from being registered.

Each answer is one clause for a person, with what to do about it, or empty where the numbers tell nothing. Feet cannot
be told: a scan whose ranges are 3.28 times too long is that of a larger place.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import PreprocessConfig
from svc_ros.core.scan import Array, PreparedScan

FARTHEST_M = 1000.0  # no sensor of the presets sees a wider place

_MOST_CROSSED = 0.12  # scans seen from their own sensor have up to 0.09
_NEARLY_ALL = 0.98
_MOST = 0.5  # share of the points that lies out of range, where that is what few are left for
_AWAY = 2.0  # times as far from the sensor as it is large: a cloud that is not around its sensor, nor before it
_LOOKING_CLOSE_MM = (300.0, 10_000.0)  # so large numbers may be millimetres of a sensor that looks one way, too
_BEYOND_ALL_M = 1e30  # what is farther is as far: its square would be no number
_THIN = 1.0 / 3.0  # of a voxel: what lies nearer to a plane or a line is on it


def explain_few_points(points: Array, sensor_origin: Array, config: PreprocessConfig) -> str:
    """Why too few of a scan's points (N, 3) [m] are left, seen from sensor_origin (3,) [m]."""
    if not np.any(points != sensor_origin):
        return (
            "no point can be used: the cloud is empty, or all of its points are NaN, inf or where the sensor stands: "
            "look at the sensor and at its driver"
        )
    if len(points) < config.min_points:
        return "the cloud has too few points itself: a part of a sweep, or thinned too much"
    by_place = explain_ranges(points, sensor_origin, config)
    return by_place or explain_shape(points, sensor_origin, config.voxel_size_m) or (
        f"what is in range fills few voxels: copies of few points, or preprocess.voxel_size_m "
        f"({config.voxel_size_m:g} m) is too large for so small a place"
    )


def explain_ranges(points: Array, sensor_origin: Array, config: PreprocessConfig) -> str:
    """Why most of at least one point (N, 3) [m] lie out of range: the unit, the frame, or the limits; else empty."""
    seen = np.clip(points - sensor_origin, -_BEYOND_ALL_M, _BEYOND_ALL_M)
    ranges = np.linalg.norm(seen, axis=1)
    reach = float(np.quantile(ranges, _NEARLY_ALL))
    near, far = float(np.mean(ranges < config.min_range_m)), float(np.mean(ranges > config.max_range_m))
    if near >= _MOST:
        return (
            f"98 % of the points lie within {reach:.3g} m: scaled (kilometres, or to a size of one), or "
            f"preprocess.min_range_m ({config.min_range_m:g} m) is too large"
        )
    if far >= _MOST:
        return _explain_far(seen, reach, config)
    if near + far < _MOST:
        return ""
    return (
        f"{near:.0%} of the points lie nearer than preprocess.min_range_m ({config.min_range_m:g} m), {far:.0%} beyond "
        f"preprocess.max_range_m ({config.max_range_m:g} m): set both to the sensor"
    )


def _explain_far(seen: Array, reach: float, config: PreprocessConfig) -> str:
    """seen: (N, 3) [m] from the sensor; most lie beyond the largest range, nearly all within `reach`."""
    centre = np.median(seen, axis=0)
    size = float(np.quantile(np.linalg.norm(seen - centre, axis=1), _NEARLY_ALL))
    away = float(np.linalg.norm(centre))
    if size > FARTHEST_M:
        if reach > 1000.0 * FARTHEST_M:
            return f"98 % of the points lie within {reach:.3g} m: neither metres nor millimetres"
        return (
            f"98 % of the points lie within {reach:.3g} m, farther than any sensor sees: millimetres? "
            f"Multiplied by 0.001 they lie within {0.001 * reach:.3g} m"
        )
    if away > _AWAY * size:
        x, y, z = centre
        may_be_mm = _LOOKING_CLOSE_MM[0] < reach < _LOOKING_CLOSE_MM[1]
        close = f", or millimetres of a sensor that looks one way, within {0.001 * reach:.2g} m" if may_be_mm else ""
        return (
            f"the points lie within {size:.3g} m of ({x:.8g}, {y:.8g}, {z:.8g}), {away:.3g} m from where the sensor is "
            f"taken to be: coordinates of a map or UTM{close}: give them in the sensor's frame, or tell where it stood "
            "(--sensor-frame, sensor_frame or sensor_origin)"
        )
    return (
        f"98 % of the points lie within {reach:.3g} m, most beyond preprocess.max_range_m ({config.max_range_m:g} m): "
        "raise it, if the sensor sees so far; else they are not in metres"
    )


def explain_crossed(crossed_ratio: float) -> str:
    """What it means that in this share of directions, in [0, 1], surfaces lie behind each other (see `RangeImage`)."""
    if crossed_ratio <= _MOST_CROSSED:
        return ""
    return (
        "not seen from where the sensor is taken to be: a cloud in a map's frame (name the sensor's by --sensor-frame "
        "or sensor_frame, or its place by sensor_origin), of several sensors (take each one's own), or accumulated"
    )


def explain_scan(scan: PreparedScan) -> str:
    """What is odd about a scan that has enough points: where it was seen from, or that it is a plane or a line."""
    crossed = 0.0 if scan.range_image is None else scan.range_image.crossed_ratio
    if found := explain_crossed(crossed):
        return f"in {crossed:.0%} of the directions several surfaces lie behind each other: {found}"
    return explain_shape(scan.points, scan.sensor_origin, scan.voxel_size_m)


def explain_shape(points: Array, sensor_origin: Array, voxel_size_m: float) -> str:
    """Whether all points of a scan, at least one (K, 3) [m], lie on one plane or on one line, and not in one place."""
    middle = points.mean(0)
    off = points - middle
    sq_spread, axes = np.linalg.eigh(off.T @ off / len(off))
    thin = _THIN * voxel_size_m
    if sq_spread[2] < thin**2:
        return ""
    if sq_spread[1] < thin**2:
        return "all points lie on one line, which fixes no pose: scans with more structure"
    if sq_spread[0] >= thin**2:
        return ""
    if abs((sensor_origin - middle) @ axes[:, 0]) < thin:
        return "all points lie in one plane with the sensor, as those of a 2D laser: too little for a pose in 3D"
    return "all points lie on one plane, which leaves shifts along it and turns in it open: scans with more structure"


def explain_pair(source: PreparedScan, target: PreparedScan) -> str:
    """What is odd about either scan of a pair, with which of them it is."""
    of_source, of_target = explain_scan(source), explain_scan(target)
    if of_source == of_target:
        return of_source and f"both scans: {of_source}"
    told = ((name, found) for name, found in (("source", of_source), ("target", of_target)) if found)
    return "; ".join(f"{name}: {found}" for name, found in told)
