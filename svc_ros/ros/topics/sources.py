"""What engines ask for besides clouds, answered from parameters, TF and the inputs."""

from __future__ import annotations

import contextlib
from typing import Protocol

import numpy as np

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.ros.parameters import NodeParameters
from svc_ros.ros.streams.localization_engine import TOLD_FOR_NS, ToldPose
from svc_ros.ros.topics.frames import Frames
from svc_ros.ros.topics.inputs import Inputs


class Parts(Protocol):
    """Who has the frames and the inputs; both may be made after the engine that asks."""

    frames: Frames
    inputs: Inputs


class Sources:
    """What engines ask for besides clouds: origins, guesses and odometry, with the parameters of the moment."""

    def __init__(self, session: Parts, parameters: NodeParameters) -> None:
        self._session, self._parameters = session, parameters
        self.odometry_frame = self._parameters.settings.odom_frame
        self.frame_of_map = self._parameters.settings.frame_of_map

    def origin(self, frame: str, stamp_ns: int) -> Array:
        """Where the sensor stood in a cloud's frame."""
        return self._session.frames.sensor_origin(self._parameters.settings, frame, stamp_ns)

    def base(self, frame: str, stamp_ns: int) -> Array:
        """T_base_cloud (4, 4); the identity where no base is asked for."""
        settings = self._parameters.settings
        if not settings.base_frame:
            return np.eye(4)
        return self._session.frames.pose(settings.base_frame, frame, stamp_ns, settings.tf_timeout)

    def guess(self, stamp_ns: int) -> Array | None:
        """The guess for a pair: the one nearest in time, if it is near enough."""
        return self._session.inputs.guesses.nearest(stamp_ns, self._parameters.settings.max_skew_ns)

    def odometry(self, scan: Scan) -> Array:
        """T_odom_cloud (4, 4) as odometry from elsewhere has it; TransformUnavailableError where it has none."""
        settings, inputs, frames = self._parameters.settings, self._session.inputs, self._session.frames
        if settings.odometry == "tf":
            return frames.pose(settings.odom_frame, scan.frame_id, scan.stamp_ns, settings.tf_timeout)
        T_odom_child = inputs.odometry.at(scan.stamp_ns, settings.max_skew_ns, settings.tf_timeout)
        child = inputs.odometry_child_frame or scan.frame_id
        return T_odom_child @ frames.pose(child, scan.frame_id, scan.stamp_ns, settings.tf_timeout)

    def told(self, scan: Scan) -> ToldPose | None:
        """Where others say that the cloud's frame stands in the map; TransformUnavailableError where TF is missing."""
        settings, frames = self._parameters.settings, self._session.frames
        if settings.told_by == "tf":
            return self._told_on_tf(scan)
        told = self._session.inputs.told.take(scan.stamp_ns)
        if told is None:
            return None
        T_map_frame = frames.fixed_pose(self.frame_of_map, told.frame_id or self.frame_of_map, settings.tf_timeout)
        return ToldPose(T_map_frame @ told.T_frame_base @ self.base(scan.frame_id, scan.stamp_ns), told.stamp_ns)

    def _told_on_tf(self, scan: Scan) -> ToldPose:
        """At the scan's stamp, or, of who needs longer than it is waited for, at the newest one that there is."""
        frames, ends = self._session.frames, (self.frame_of_map, scan.frame_id)
        try:
            return ToldPose(frames.pose(*ends, scan.stamp_ns, self._parameters.settings.tf_timeout), scan.stamp_ns)
        except TransformUnavailableError:
            with contextlib.suppress(TransformUnavailableError):
                T, stamp_ns = frames.newest_pose(*ends)
                if 0 <= scan.stamp_ns - stamp_ns < TOLD_FOR_NS:
                    return ToldPose(T, stamp_ns)
            raise
