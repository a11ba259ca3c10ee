"""Core types <-> ROS messages. Nothing here decides anything."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array
from svc_ros.core.se3 import make_pose
from svc_ros.io.clouds.point_cloud2 import cloud_layout
from svc_ros.io.config_yaml import NODE_NAME
from svc_ros.io.results import UNKNOWN_COVARIANCE
from svc_ros.io.stamps import seconds_and_rest
from svc_ros.ros.streams.decision import MapPlace, OdometryEstimate

# Of a velocity that is not known, (m/s)^2 and (rad/s)^2: whoever weighs by covariances takes nothing from it. Not
# negative or infinite, which spoils filters that do not look.
UNKNOWN_VELOCITY_COVARIANCE = 1e6 * np.eye(6)
_FAULTS = (Reason.INTERNAL_ERROR, Reason.TF_UNAVAILABLE)


def header(stamp_ns: int, frame_id: str) -> Header:
    """A header with a stamp in nanoseconds."""
    sec, nanosec = seconds_and_rest(stamp_ns)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def transform_message(
    T_target_source: ArrayLike, stamp_ns: int, target_frame: str, source_frame: str
) -> TransformStamped:
    """Parent = target, child = source: p_target = T p_source."""
    T = np.asarray(T_target_source, np.float64)
    x, y, z = T[:3, 3].tolist()
    transform = Transform(translation=Vector3(x=x, y=y, z=z), rotation=_quaternion(T))
    return TransformStamped(header=header(stamp_ns, target_frame), child_frame_id=source_frame, transform=transform)


def pose_message(result: RegistrationResult, stamp_ns: int, target_frame: str) -> PoseWithCovarianceStamped:
    """The source's frame as a pose in the target frame; InputError unless the result is accepted."""
    if result.T_target_source is None:
        raise InputError(f"expected an accepted result, found {result.verdict.value} ({result.reason.value})")
    message = PoseWithCovarianceStamped(header=header(stamp_ns, target_frame))
    message.pose.pose = plain_pose(result.T_target_source)
    covariance = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
    message.pose.covariance = np.asarray(covariance, np.float64).reshape(-1)
    return message


def place_message(place: MapPlace, stamp_ns: int, map_frame: str) -> PoseWithCovarianceStamped:
    """Where the robot stands in the map, with the covariance of its position and its turns about the fixed axes.

    InputError where the place is not known.
    """
    if place.T_map_base is None or place.covariance is None:
        raise InputError("expected a place that is known, found none")
    message = PoseWithCovarianceStamped(header=header(stamp_ns, map_frame))
    message.pose.pose = plain_pose(place.T_map_base)
    message.pose.covariance = _about_the_pose(place.covariance, place.T_map_base).reshape(-1)
    return message


def plain_pose(T: Array) -> Pose:
    """A (4, 4) pose as a message without stamp and frame."""
    x, y, z = T[:3, 3].tolist()
    return Pose(position=Point(x=x, y=y, z=z), orientation=_quaternion(T))


def odometry_message(estimate: OdometryEstimate, stamp_ns: int, odometry_frame: str, child_frame: str) -> Odometry:
    """Pose of the child frame in the odometry frame, with the covariance of its position and its turns about the
    fixed axes; velocity in the child frame, for the first scan zeros with UNKNOWN_VELOCITY_COVARIANCE."""
    message = Odometry(header=header(stamp_ns, odometry_frame), child_frame_id=child_frame)
    message.pose.pose = plain_pose(estimate.T_odom_base)
    message.pose.covariance = _about_the_pose(estimate.covariance, estimate.T_odom_base).reshape(-1)
    if estimate.velocity is None or estimate.velocity_covariance is None:
        message.twist.covariance = UNKNOWN_VELOCITY_COVARIANCE.reshape(-1)
        return message
    linear, angular = estimate.velocity[:3].tolist(), estimate.velocity[3:].tolist()
    message.twist.twist.linear = Vector3(x=linear[0], y=linear[1], z=linear[2])
    message.twist.twist.angular = Vector3(x=angular[0], y=angular[1], z=angular[2])
    message.twist.covariance = estimate.velocity_covariance.reshape(-1)
    return message


def _about_the_pose(covariance: Array, T: Array) -> Array:
    """(6, 6) of a perturbation on the left as that of the position itself: a turn about the origin moves it, too."""
    x, y, z = T[:3, 3]
    lever = np.eye(6)
    lever[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return np.asarray(lever @ covariance @ lever.T)


def pose_from_message(message: PoseWithCovarianceStamped | Odometry) -> Array:
    """The (4, 4) pose of a message; InputError if its quaternion has no direction or a number is not finite."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    values = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if not np.isfinite(values).all() or np.linalg.norm(values[3:]) < 1e-6:
        raise InputError(f"pose: expected finite numbers and a unit quaternion, found {values.tolist()}")
    return make_pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def cloud_message(
    points: ArrayLike, stamp_ns: int, frame_id: str, columns: Mapping[str, ArrayLike] | None = None
) -> PointCloud2:
    """Points (N, 3) [m] and optional columns (N,) as a cloud of FLOAT32 fields."""
    layout = cloud_layout(points, columns)
    return PointCloud2(
        header=header(stamp_ns, frame_id),
        height=layout.height,
        width=layout.width,
        fields=[PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in layout.fields],
        is_bigendian=layout.is_bigendian,
        point_step=layout.point_step,
        row_step=layout.row_step,
        data=layout.data,
        is_dense=layout.is_dense,
    )


def status_name(node: Node) -> str:
    """What a node's statuses are told under: its name, with its namespace, because several nodes tell on one topic."""
    return str(node.get_fully_qualified_name().lstrip("/"))


def decision_message(
    result: RegistrationResult, values: Mapping[str, str], stamp_ns: int, frame_id: str, node: str = NODE_NAME
) -> DiagnosticArray:
    """One decision as one status of `node`: OK = accepted, ERROR = a fault of the system, WARN = everything else."""
    status = DiagnosticStatus(
        level=_level(result),
        name=f"{node}: decision",
        message=f"{result.verdict.value}: {result.reason.value}" + (f" ({result.detail})" if result.detail else ""),
        hardware_id=node,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=header(stamp_ns, frame_id), status=[status])


def _level(result: RegistrationResult) -> bytes:
    if result.verdict is Verdict.ACCEPTED:
        return bytes(DiagnosticStatus.OK)
    return bytes(DiagnosticStatus.ERROR if result.reason in _FAULTS else DiagnosticStatus.WARN)


def _quaternion(T: Array) -> Quaternion:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return Quaternion(x=x, y=y, z=z, w=w)
