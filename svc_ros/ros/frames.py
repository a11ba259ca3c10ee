"""Where the sensor stood in a cloud's frame, and transforms on /tf. The one place that may use tf2.

tf2 is not needed where clouds are in their sensor's frame, or where `sensor_origin` says where it stands.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.time import Time
from std_msgs.msg import Header

from svc_ros.core.errors import MissingDependencyError, TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.io.bag_writers import distinct_frames
from svc_ros.ros.parameters import NodeSettings

_NEEDS_TF2 = "sensor_frame needs tf2_ros (apt install ros-jazzy-tf2-ros-py), or set sensor_origin instead"
_NEEDS_TF2_MSGS = "publish_tf needs tf2_msgs (apt install ros-jazzy-tf2-msgs)"


class SensorOrigins:
    """Answers where the sensor stood, from parameters or from TF.

    Raises MissingDependencyError when built with a `sensor_frame` and without tf2. `lookup` may block for
    `tf_timeout`: it belongs on the worker's thread, while the node's executor receives the transforms.
    """

    def __init__(self, node: Node, settings: NodeSettings) -> None:
        self._node = node
        self._buffer: Any = None
        if settings.sensor_frame:
            self._buffer = _tf_buffer(node)

    def lookup(self, settings: NodeSettings, cloud_frame: str, stamp_ns: int) -> Array:
        """The sensor's position (3,) [m] in `cloud_frame` at the cloud's stamp; TransformUnavailableError without."""
        if settings.sensor_frame in ("", cloud_frame):
            return np.array(settings.sensor_origin)
        try:
            self._buffer = self._buffer or _tf_buffer(self._node)
            found = self._buffer.lookup_transform(
                cloud_frame, settings.sensor_frame, Time(nanoseconds=stamp_ns), Duration(seconds=settings.tf_timeout)
            )
        except Exception as error:  # tf2's own family cannot be named where tf2 is absent
            frames = f"from {settings.sensor_frame!r} to {cloud_frame!r} at {stamp_ns} ns"
            raise TransformUnavailableError(f"expected a transform {frames}: {error}") from error
        t = found.transform.translation
        return np.array([t.x, t.y, t.z])


class TransformOutput:
    """Publishes accepted transforms on /tf, with frame names that differ. Raises MissingDependencyError."""

    def __init__(self, node: Node) -> None:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise MissingDependencyError(_NEEDS_TF2_MSGS) from None
        self._message_type = TFMessage
        self._publisher = node.create_publisher(TFMessage, "/tf", QoSProfile(depth=100))

    def publish(self, message: TransformStamped, child_frame: str) -> None:
        """Send the transform; scans of one sensor share a frame, so the child is then `child_frame` or FRAME/source."""
        parent, child = distinct_frames(message.header.frame_id, child_frame or message.child_frame_id)
        header = Header(stamp=message.header.stamp, frame_id=parent)
        named = TransformStamped(header=header, child_frame_id=child, transform=message.transform)
        self._publisher.publish(self._message_type(transforms=[named]))


def _tf_buffer(node: Node) -> Any:
    try:
        from tf2_ros import Buffer, TransformListener
    except ImportError:
        raise MissingDependencyError(_NEEDS_TF2) from None
    buffer = Buffer()
    buffer.svc_listener = TransformListener(buffer, node)  # kept alive by the buffer that it fills
    return buffer
