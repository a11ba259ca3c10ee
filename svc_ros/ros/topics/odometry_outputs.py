"""Scan matching's own topics: odometry, path and the odometry frame on /tf."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from svc_ros.core.scan import Array
from svc_ros.core.se3 import invert
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.topics.conversions import header, odometry_message, plain_pose, transform_message
from svc_ros.ros.topics.frames import TransformOutput

_KEPT_POSES = 1000  # longer paths lose every second pose
_DEPTH = QoSProfile(depth=100)
_LAST_PATH = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class OdometryOutputs:
    """Publishes `~/odometry` and /tf with each accepted scan, and `~/path` whenever `publish_path` is called."""

    def __init__(self, node: Node, tf: TransformOutput | None) -> None:
        self._node, self._tf = node, tf
        self._odometry = node.create_publisher(Odometry, "~/odometry", _DEPTH)
        self._path = node.create_publisher(Path, "~/path", _LAST_PATH)
        self._lock = threading.Lock()
        self._poses: list[tuple[int, Array]] = []
        self._stride, self._num_seen, self._is_new = 1, 0, False

    def publish(self, decision: Decision, settings: NodeSettings) -> None:
        """Send what an accepted scan says; called by the worker."""
        estimate, source = decision.odometry, decision.source
        if estimate is None or source is None:
            return
        frame, child = settings.odom_frame, settings.base_frame or source.frame_id
        message = odometry_message(estimate, source.stamp_ns, frame, child)
        tell_fixed_covariances(message, settings, estimate.velocity is not None)
        self._odometry.publish(message)
        if self._tf is not None and settings.invert_odom_tf:
            self._tf.publish(transform_message(invert(estimate.T_odom_base), source.stamp_ns, child, frame), "")
        elif self._tf is not None:
            transform = transform_message(estimate.T_odom_base, source.stamp_ns, frame, child)
            self._tf.publish(transform, settings.tf_child_frame)
        with self._lock:
            if decision.origin == "start":
                self._poses, self._stride, self._num_seen = [], 1, 0
            self._keep(source.stamp_ns, estimate.T_odom_base)

    def publish_path(self, settings: NodeSettings) -> None:
        """Send the way so far, if it has changed and somebody listens; a long one takes milliseconds."""
        with self._lock:
            if not self._is_new or not self._path.get_subscription_count():
                return
            self._is_new = False
            poses = list(self._poses)
        message = Path(header=header(poses[-1][0], settings.odom_frame))
        message.poses = [
            PoseStamped(header=header(stamp_ns, settings.odom_frame), pose=plain_pose(T)) for stamp_ns, T in poses
        ]
        self._path.publish(message)

    def destroy(self) -> None:
        """Give the publishers back."""
        publishers: list[Any] = [self._odometry, self._path]
        for publisher in publishers:
            self._node.destroy_publisher(publisher)

    def _keep(self, stamp_ns: int, T: Array) -> None:
        """Keep every `stride`-th pose, and always the last one."""
        if self._num_seen and (self._num_seen - 1) % self._stride:
            self._poses.pop()
        self._poses.append((stamp_ns, T))
        self._num_seen += 1
        self._is_new = True
        if len(self._poses) > _KEPT_POSES:
            last = self._poses[-1]
            self._poses = self._poses[::2]
            self._stride *= 2
            if self._poses[-1] is not last:
                self._poses.append(last)


def tell_fixed_covariances(message: Odometry, settings: NodeSettings, has_velocity: bool) -> None:
    """Let the variances of the settings take the place of the computed ones; what is 0 there stays as computed.

    A fixed half (position or orientation, speed or turn rate) has nothing in common with the other one any more. What
    is told of a velocity that is not known stays.
    """
    fixed = settings.position_covariance, settings.orientation_covariance
    message.pose.covariance = _with_fixed(message.pose.covariance, fixed)
    if has_velocity:
        fixed = settings.linear_velocity_covariance, settings.angular_velocity_covariance
        message.twist.covariance = _with_fixed(message.twist.covariance, fixed)


def _with_fixed(covariance: Any, variances: tuple[float, float]) -> Array:
    """The (36,) covariance with these variances [squared units] of its first and last three rows."""
    told = np.array(covariance, np.float64).reshape(6, 6)
    for half, variance in zip((slice(0, 3), slice(3, 6)), variances, strict=True):
        if variance > 0.0:
            told[half], told[:, half] = 0.0, 0.0
            told[half, half] = variance * np.eye(3)
    return told.reshape(-1)
