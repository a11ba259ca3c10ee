"""Odometry as it is told: covariances that grow along the chain of scans, velocities, the robot's base."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict

import numpy as np

from svc_ros.core import se3
from svc_ros.core.scan import Array
from svc_ros.io.g2o import adjoint
from svc_ros.io.results import UNKNOWN_COVARIANCE
from svc_ros.pipeline.motion import scale_motion
from svc_ros.pipeline.stream import StreamDecision
from svc_ros.ros.streams.decision import OdometryEstimate

_KEPT_COVARIANCES = 2000


class OdometryTrack:
    """Covariances along the chain of accepted scans, and the velocity between the last two of them.

    T_told_odom: (4, 4), from the matcher's odometry frame, where its first scan stood, to the one that is told, where
    the robot's base stood at that moment.
    """

    def __init__(self) -> None:
        self.T_told_odom = np.eye(4)
        self._covariances: OrderedDict[int, Array] = OrderedDict()
        self._last: tuple[int, Array, Array] | None = None  # stamp, pose, covariance relative to its target

    def add(self, decision: StreamDecision, T_base_cloud: Array) -> OdometryEstimate | None:
        """What is told of an accepted scan, whose frame stands at T_base_cloud (4, 4); None of all others."""
        result, pose, T_odom_target = decision.result, decision.T_odom_source, decision.T_odom_target
        if pose is None or T_odom_target is None:
            return None
        relative = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
        if decision.origin == "start":
            self._covariances.clear()
            self._last, self.T_told_odom = None, T_base_cloud
        covariance = self._chained(decision, adjoint(T_odom_target), relative)
        # On the right of the pose, so in the sensor's own frame.
        to_sensor = adjoint(se3.invert(pose)) @ adjoint(T_odom_target)
        own = to_sensor @ relative @ to_sensor.T
        velocity = self._velocity(decision.source_stamp_ns, pose, own)
        self._last = decision.source_stamp_ns, pose, own
        to_told, to_base = adjoint(self.T_told_odom), adjoint(T_base_cloud)
        told = OdometryEstimate(self.T_told_odom @ pose @ se3.invert(T_base_cloud), to_told @ covariance @ to_told.T)
        if velocity is None:
            return told
        speed, uncertainty = velocity
        return dataclasses.replace(
            told, velocity=to_base @ speed, velocity_covariance=to_base @ uncertainty @ to_base.T
        )

    def _chained(self, decision: StreamDecision, to_odometry: Array, relative: Array) -> Array:
        """The target's covariance and the pose's own, in the odometry frame."""
        before = self._covariances.get(decision.target_stamp_ns)
        if before is None and self._covariances:
            before = next(reversed(self._covariances.values()))  # not known any more; the last one is no smaller
        covariance = to_odometry @ relative @ to_odometry.T
        covariance = covariance if before is None else covariance + before
        if decision.target_stamp_ns in self._covariances:
            self._covariances.move_to_end(decision.target_stamp_ns)
        self._covariances[decision.source_stamp_ns] = covariance
        while len(self._covariances) > _KEPT_COVARIANCES:
            self._covariances.popitem(last=False)
        return covariance

    def _velocity(self, stamp_ns: int, pose: Array, own: Array) -> tuple[Array, Array] | None:
        """Of the cloud's frame, in itself: (6,) [m/s, rad/s] and its covariance (6, 6)."""
        if self._last is None:
            return None
        last_ns, last_pose, last_own = self._last
        seconds = 1e-9 * (stamp_ns - last_ns)
        step = se3.invert(last_pose) @ pose
        small = 1e-3  # a thousandth of the step is straight enough to be read as a velocity
        part = scale_motion(step, small)
        turn = 0.5 * np.array([part[2, 1] - part[1, 2], part[0, 2] - part[2, 0], part[1, 0] - part[0, 1]])
        velocity = np.concatenate([part[:3, 3], turn]) / (small * seconds)
        return velocity, (own + last_own) / seconds**2
