"""A ROS 2 bag folder in the MCAP format, and the messages that go into one, with no ROS installed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.se3 import Array
from svc_ros.io.clouds.point_cloud2 import cloud_layout
from svc_ros.io.stamps import seconds_and_rest

TRANSFORM_TYPE = "geometry_msgs/msg/TransformStamped"
CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class McapFolder:
    """A ROS 2 bag folder being written, with the message types of Jazzy."""

    def __init__(self, folder: Path, compress: bool = False) -> None:
        try:
            from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise MissingDependencyError("writing bags needs rosbags: pip install 'rosbags>=0.11'") from None
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.connections: dict[str, Any] = {}
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        if compress:  # chunk by chunk, which every reader of the format undoes by itself
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic; a latched one is offered as transient local with depth 1."""
        profile = [_qos(latched)]
        self.connections[topic] = self._writer.add_connection(
            topic, msgtype, typestore=self.store, offered_qos_profiles=profile
        )

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Write a message of a declared topic."""
        connection = self.connections[topic]
        self._writer.write(connection, stamp_ns, self.store.serialize_cdr(message, connection.msgtype))

    def close(self) -> None:
        """Write the index and metadata.yaml."""
        self._writer.close()

    def make(self, msgtype: str, **fields: Any) -> Any:
        """A message by its type and fields."""
        return self.store.types[msgtype](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """std_msgs/Header."""
        sec, nanosec = seconds_and_rest(stamp_ns)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)

    def transform(self, header: Any, child: str, T: Array) -> Any:
        """TransformStamped whose header names the parent."""
        moved = self.make(
            "geometry_msgs/msg/Transform", translation=self._xyz("Vector3", T), rotation=self._quaternion(T)
        )
        return self.make(TRANSFORM_TYPE, header=header, child_frame_id=child, transform=moved)

    def pose(self, header: Any, T: Array, covariance: Array) -> Any:
        """PoseWithCovarianceStamped; covariance (6, 6)."""
        pose = self.make("geometry_msgs/msg/Pose", position=self._xyz("Point", T), orientation=self._quaternion(T))
        covered = self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance.ravel().copy())
        return self.make(POSE_TYPE, header=header, pose=covered)

    def status(self, name: str, level: str, message: str, values: Mapping[str, str]) -> Any:
        """DiagnosticStatus; level: OK, WARN or ERROR."""
        kind = self.store.types["diagnostic_msgs/msg/DiagnosticStatus"]
        pairs = [self.make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
        code: int = getattr(kind, level)
        return self.make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=code, name=name, message=message, hardware_id="", values=pairs,
        )  # fmt: skip

    def cloud(self, header: Any, points: ArrayLike, columns: Mapping[str, ArrayLike] | None = None) -> Any:
        """PointCloud2 of points (N, 3) [m] and optional columns (N,), all FLOAT32."""
        layout = cloud_layout(points, columns)
        return self.make(
            CLOUD_TYPE, header=header, height=layout.height, width=layout.width,
            fields=[self.make("sensor_msgs/msg/PointField", **field._asdict()) for field in layout.fields],
            point_step=layout.point_step, row_step=layout.row_step, is_bigendian=layout.is_bigendian,
            is_dense=layout.is_dense, data=np.frombuffer(layout.data, np.uint8),
        )  # fmt: skip

    def _xyz(self, kind: str, T: Array) -> Any:
        x, y, z = T[:3, 3].tolist()
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _quaternion(self, T: Array) -> Any:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _qos(latched: bool) -> Any:
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
