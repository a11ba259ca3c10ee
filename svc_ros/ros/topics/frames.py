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
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from svc_ros.core.errors import MissingDependencyError, TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import make_pose
from svc_ros.io.bags.writers import distinct_frames
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import named_side
from svc_ros.ros.streams.worker import CloudLabel

_NEEDS_TF2 = "{} needs tf2_ros (apt install ros-jazzy-tf2-ros-py){}"
_NEWEST_NS, _LONG_AGO_NS = 0, 1  # tf2 takes 0 for the newest; no dynamic transform is kept so long as 1
_NEEDS_TF2_MSGS = "{} needs tf2_msgs (apt install ros-jazzy-tf2-msgs)"


class Frames:
    """Answers where frames stand to each other, from parameters or from TF.

    Raises MissingDependencyError when built with a parameter that needs tf2, and without tf2. Look-ups may block for
    `tf_timeout`: they belong on the worker's thread, while the node's executor receives the transforms.
    """

    def __init__(self, node: Node, settings: NodeSettings) -> None:
        self._node = node
        self._buffer: Any = None
        self._listener: Any = None
        if needs := _needs_tf(settings):
            self.listen(needs)

    def listen(self, wanted_by: str) -> None:
        """Receive transforms from now on; MissingDependencyError without tf2 names what wants them."""
        if self._buffer is None:
            self._start_listening(wanted_by)

    def sensor_origin(self, settings: NodeSettings, cloud_frame: str, stamp_ns: int) -> Array:
        """The sensor's position (3,) [m] in `cloud_frame` at the cloud's stamp; TransformUnavailableError without."""
        if settings.sensor_frame in ("", cloud_frame):
            return np.array(settings.sensor_origin)
        return self.pose(cloud_frame, settings.sensor_frame, stamp_ns, settings.tf_timeout)[:3, 3]

    def check_one_stamp(self, settings: NodeSettings, source: CloudLabel, target: CloudLabel) -> None:
        """Refuse two scans with one stamp where the sensor moves in the frames of both: TF has one place for two.

        One of the stamps is not the scan's own then. Raises TransformUnavailableError, also where TF has no place.
        """
        sides = {"source": source.frame_id, "target": target.frame_id}
        if source.stamp_ns != target.stamp_ns or settings.sensor_frame in ("", *sides.values()):
            return
        if all(self._moves(settings, side, frame, source.stamp_ns) for side, frame in sides.items()):
            frames = " and ".join(repr(frame) for frame in dict.fromkeys(sides.values()))
            raise TransformUnavailableError(
                f"expected a place of the sensor for each of two scans, found one: both have the stamp "
                f"{text_from_ns(source.stamp_ns)} s and come in {frames}, where {settings.sensor_frame!r} moves; send "
                "them in the sensor's frame, or in one that is fixed to it, such as the base's"
            )

    def pose(self, target_frame: str, source_frame: str, stamp_ns: int, timeout_s: float) -> Array:
        """T_target_source (4, 4) by TF at a stamp, the identity within one frame.

        Raises TransformUnavailableError naming both frames, and MissingDependencyError without tf2.
        """
        if target_frame == source_frame:
            return np.eye(4)
        return _pose_of(self._look_up(target_frame, source_frame, stamp_ns, timeout_s))

    def newest_pose(self, target_frame: str, source_frame: str) -> tuple[Array, int]:
        """The newest T_target_source (4, 4) that TF has, without waiting, and its stamp; raises like `pose`."""
        found = self._look_up(target_frame, source_frame, _NEWEST_NS, 0.0)
        return _pose_of(found), ns_from_stamp(found.header.stamp)

    def fixed_pose(self, target_frame: str, source_frame: str, timeout_s: float) -> Array:
        """T_target_source (4, 4) by static transforms alone, which hold at any time; raises like `pose`."""
        try:
            return self.pose(target_frame, source_frame, _LONG_AGO_NS, timeout_s)
        except TransformUnavailableError as error:
            frames = f"from {source_frame!r} to {target_frame!r}"
            raise TransformUnavailableError(f"expected a static transform {frames}: {error.__cause__}") from error

    def clear(self) -> None:
        """Forget what was received: time starts anew."""
        if self._buffer is not None:
            self._buffer.clear()

    def destroy(self) -> None:
        """Stop listening."""
        if self._listener is not None:
            self._listener.unregister()
        self._buffer = self._listener = None

    def _moves(self, settings: NodeSettings, side: str, frame: str, stamp_ns: int) -> bool:
        """True unless the sensor has always stood where it does now: only static transforms are known of all times."""
        try:
            now = self.sensor_origin(settings, frame, stamp_ns)
        except TransformUnavailableError as error:
            raise named_side(side, error) from error
        try:
            long_ago = self.pose(frame, settings.sensor_frame, _LONG_AGO_NS, 0.0)[:3, 3]
        except TransformUnavailableError:
            return True
        return not np.allclose(now, long_ago)

    def _look_up(self, target_frame: str, source_frame: str, stamp_ns: int, timeout_s: float) -> Any:
        self.listen(f"a transform from {source_frame!r} to {target_frame!r}")
        try:
            return self._buffer.lookup_transform(
                target_frame, source_frame, Time(nanoseconds=stamp_ns), Duration(seconds=timeout_s)
            )
        except Exception as error:  # tf2's own family cannot be named where tf2 is absent
            frames = f"from {source_frame!r} to {target_frame!r} at {text_from_ns(stamp_ns)} s"
            raise TransformUnavailableError(f"expected a transform {frames}: {error}") from error

    def _start_listening(self, wanted_by: str) -> None:
        try:
            from tf2_ros import Buffer, TransformListener
        except ImportError:
            instead = ", or set sensor_origin instead" if wanted_by == "sensor_frame" else ""
            raise MissingDependencyError(_NEEDS_TF2.format(wanted_by, instead)) from None
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, self._node)


class TransformOutput:
    """Publishes transforms on /tf, with frame names that differ.

    wanted_by: the parameter that asks for it, named by the MissingDependencyError where tf2_msgs is missing.
    """

    def __init__(self, node: Node, wanted_by: str) -> None:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise MissingDependencyError(_NEEDS_TF2_MSGS.format(wanted_by)) from None
        self._node, self._message_type = node, TFMessage
        self._publisher = node.create_publisher(TFMessage, "/tf", QoSProfile(depth=100))

    def publish(self, message: TransformStamped, child_frame: str) -> None:
        """Send the transform; scans of one sensor share a frame, so the child is then `child_frame` or FRAME/source."""
        parent, child = distinct_frames(message.header.frame_id, child_frame or message.child_frame_id)
        header = Header(stamp=message.header.stamp, frame_id=parent)
        named = TransformStamped(header=header, child_frame_id=child, transform=message.transform)
        self._publisher.publish(self._message_type(transforms=[named]))

    def destroy(self) -> None:
        """Give the publisher back."""
        self._node.destroy_publisher(self._publisher)


def _pose_of(found: Any) -> Array:
    """(4, 4) of a transform's message."""
    t, q = found.transform.translation, found.transform.rotation
    return make_pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (t.x, t.y, t.z))


def _needs_tf(settings: NodeSettings) -> str:
    """The first parameter that cannot do without TF; empty if none."""
    if settings.sensor_frame:
        return "sensor_frame"
    if settings.map_frame and settings.mode == "pair":
        return "map_frame"
    if settings.base_frame and settings.mode in ("scan_matching", "localization"):
        return "base_frame"
    if settings.told_by == "tf" and settings.mode == "localization":
        return "told_by:=tf"
    return "odometry:=tf" if settings.mode in ("loop_closure", "localization") and settings.odometry == "tf" else ""
