"""The sensor's motion from scan to scan: KISS-ICP in two steps, so that only a trusted motion enters its map."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.scan import Array, Scan
from svc_ros.core.scans.preprocess import crop_range

_UNLIMITED_M = 1e9  # the range crop is done by `crop_range`, which knows where the sensor stands
_MAX_GAPS = 3.0  # a velocity is kept over at most so many of the time spans that it was measured over
_SMALL_ANGLE = 1e-6
_CONVERGED = 1e-4  # [m] and [rad] together
# ICP keeps the interpreter, 1 to 2 ms a round. Between calls other threads get their turn, and that takes a pause: a
# thread that only lets go takes the lock again before another wakes up, and the others waited for all calls together.
_ROUNDS_AT_ONCE, _TURN_OF_OTHERS_S = 4, 1e-4


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion that nobody has judged yet.

    scan: without the sensor's own motion, as if all of it had been measured at its stamp; T_odom_scan: (4, 4), where
    KISS-ICP puts it; T_start: (4, 4), where it started from; map_points (M, 3), icp_points (K, 3) [m]: what goes into
    the map, and what is aligned with it.
    """

    scan: Scan
    T_odom_scan: Array
    T_start: Array
    map_points: Array
    icp_points: Array


class KissMotion:
    """KISS-ICP whose map, threshold and velocity change by `keep` alone.

    The velocity is the one of the last two kept poses, over the time between their stamps: scans that are missing or
    were not kept do not shorten it. One thread, so that the same scans give the same bits. Raises
    MissingDependencyError without the kiss-icp package.
    """

    def __init__(self, config: Config) -> None:
        self._preprocess = config.preprocess
        self._kiss, self._sweep = _make_kiss(config)
        self._num_calls = max(config.scan_matching.max_iterations // _ROUNDS_AT_ONCE, 1)
        self._last: tuple[int, Array] | None = None  # stamp and pose of the last kept scan
        self._span_s, self._step = 0.0, np.eye(4)  # the motion that the velocity comes from

    def estimate(self, scan: Scan) -> Motion:
        """Where the scan stands, without keeping it; the first one stands at the origin."""
        deskewed = self._deskew(scan)
        points = crop_range(deskewed.points, deskewed.sensor_origin, self._preprocess)
        icp_points, map_points = self._kiss.voxelize(np.ascontiguousarray(points))
        start = self._predict(scan.stamp_ns)
        return Motion(deskewed, self._align(icp_points, start), start, map_points, icp_points)

    def estimate_again(self, motion: Motion, T_start: Array) -> Motion:
        """The same scan's motion, searched from another pose (4, 4)."""
        return dataclasses.replace(motion, T_odom_scan=self._align(motion.icp_points, T_start), T_start=T_start)

    def keep(self, motion: Motion, T_odom_scan: Array, found_by_motion: bool = True) -> None:
        """Put the scan into the map at its trusted pose (4, 4) and take the velocity from there.

        found_by_motion: False for a pose that comes from elsewhere and says nothing about the prediction.
        """
        if found_by_motion and self._last is not None:
            self._kiss.adaptive_threshold.update_model_deviation(se3.invert(motion.T_start) @ T_odom_scan)
        if self._last is not None:
            self._span_s = 1e-9 * (motion.scan.stamp_ns - self._last[0])
            self._step = se3.invert(self._last[1]) @ T_odom_scan
        self._last = (motion.scan.stamp_ns, T_odom_scan)
        self._kiss.local_map.update(motion.map_points, T_odom_scan)

    def _align(self, points: Array, T_start: Array) -> Array:
        sigma, pose = self._kiss.adaptive_threshold.get_threshold(), T_start
        for _ in range(self._num_calls):
            time.sleep(_TURN_OF_OTHERS_S)
            last, pose = pose, self._kiss.registration.align_points_to_map(
                points=points, voxel_map=self._kiss.local_map, initial_guess=pose,
                max_correspondance_distance=3.0 * sigma, kernel=sigma,
            )  # fmt: skip
            angle, distance = se3.pose_error(pose, last)
            if np.hypot(np.radians(angle), distance) < _CONVERGED:
                break
        return se3.nearest_pose(pose)

    def _predict(self, stamp_ns: int) -> Array:
        if self._last is None:
            return np.eye(4)
        return self._last[1] @ self._move(1e-9 * (stamp_ns - self._last[0]))

    def _move(self, seconds: float) -> Array:
        """The motion (4, 4) over that time at the last velocity; none where that is not known or long ago."""
        if self._span_s <= 0.0 or abs(seconds) > _MAX_GAPS * self._span_s:
            return np.eye(4)
        return scale_motion(self._step, seconds / self._span_s)

    def _deskew(self, scan: Scan) -> Scan:
        """The scan as seen from where the sensor stood at its stamp, at the last velocity."""
        times = scan.point_times_s
        if times is None or not len(times) or float(np.ptp(times)) <= 0.0:
            return scan
        first, last = float(times.min()), float(times.max())
        at_end = self._sweep.preprocess(
            np.array(scan.points), (times - first) / (last - first), self._move(last - first)
        )
        return dataclasses.replace(scan, points=se3.apply(self._move(last), at_end), point_times_s=None)


def scale_motion(T: Array, factor: float) -> Array:
    """The motion T (4, 4) carried on or back at its own constant velocity: factor 0.5 is half the way.

    Turns and shifts together, along the screw that T is; its angle must be below 180 deg.
    """
    turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    velocity = np.linalg.solve(_left_jacobian(turn), T[:3, 3])
    scaled = factor * turn
    return se3.make_pose(Rotation.from_rotvec(scaled).as_matrix(), _left_jacobian(scaled) @ (factor * velocity))


def _left_jacobian(turn: Array) -> Array:
    """Mean rotation (3, 3) over a turn (3,) [rad] at constant rate."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < _SMALL_ANGLE:
        return np.eye(3) + 0.5 * K
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * K + second * K @ K)


def _make_kiss(config: Config) -> tuple[Any, Any]:
    """KISS-ICP, and its motion compensation for points at any range."""
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
        from kiss_icp.preprocess import Preprocessor
    except ImportError:
        raise MissingDependencyError("scan matching needs kiss-icp: pip install 'kiss-icp>=1.2'") from None
    limits = config.scan_matching
    values = KISSConfig(  # every value is given: what is not could come from environment variables
        data={"max_range": config.preprocess.max_range_m, "min_range": 0.0, "deskew": True},
        mapping={"voxel_size": limits.map_voxel_size_m, "max_points_per_voxel": 20},
        registration={
            "max_num_iterations": min(limits.max_iterations, _ROUNDS_AT_ONCE), "convergence_criterion": _CONVERGED,
            "max_num_threads": 1,
        },
        adaptive_threshold={
            "fixed_threshold": None, "initial_threshold": limits.first_threshold_m, "min_motion_th": 0.1
        },
    )  # fmt: skip
    return KissICP(values), Preprocessor(_UNLIMITED_M, 0.0, True, 1)
