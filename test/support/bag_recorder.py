"""Writes small bags of every generation and storage, for the tests of what reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

S = 1_000_000_000
START = 1_700_000_000 * S + 123_456_789
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
STORAGES = ("db3", "mcap", "mcap_file_zstd", "mcap_message_zstd", "mcap_chunk_zstd", "ros1", "ros1_lz4")


class Recorder:
    """Fills a bag of any generation with small messages of one type store."""

    def __init__(self, writer: Any, ros1: bool) -> None:
        self.writer, self.ros1 = writer, ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
        if ros1:  # not among the types of ROS 1 that rosbags brings
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self.connections: dict[str, Any] = {}

    def make(self, msgtype: str, **fields: Any) -> Any:
        return self.store.types[msgtype](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // S, nanosec=stamp_ns % S)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **({"seq": 0} if self.ros1 else {}))

    def write(self, topic: str, msgtype: str, stamp_ns: int, message: Any) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, msgtype, typestore=self.store)
        serialise = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], stamp_ns, serialise(message, msgtype))

    def cloud(self, topic: str, stamp_ns: int, points: np.ndarray, names: str = "xyz") -> None:
        fields = [
            self.make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1)
            for k, name in enumerate(names)
        ]
        data = np.frombuffer(points.astype("<f4").tobytes(), np.uint8)
        message = self.make(
            CLOUD, header=self.header(stamp_ns, "lidar"), height=1, width=len(points), fields=fields, point_step=12,
            row_step=12 * len(points), is_bigendian=False, is_dense=True, data=data,
        )  # fmt: skip
        self.write(topic, CLOUD, stamp_ns, message)

    def transform(self, topic: str, stamp_ns: int, frames: tuple[str, str], numbers: tuple[float, ...]) -> None:
        names = zip("xyzw", numbers[3:], strict=True)
        moved = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", numbers[:3], strict=True))),
            rotation=self.make("geometry_msgs/msg/Quaternion", **dict(names)),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, frames[0]), child_frame_id=frames[1], transform=moved,
        )  # fmt: skip
        self.write(topic, TF, stamp_ns, self.make(TF, transforms=[stamped]))


def record(path: Path, storage: str, fill: Callable[[Recorder], None]) -> Path:
    """Write a bag; returns the path that opens it."""
    writer: Any
    if storage.startswith("ros1"):
        path = path.with_suffix(".bag")
        writer = Ros1Writer(path)
        if storage == "ros1_lz4":
            writer.set_compression(Ros1Writer.CompressionFormat.LZ4)
    else:
        plugin = StoragePlugin.SQLITE3 if storage == "db3" else StoragePlugin.MCAP
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
        modes = {"file": CompressionMode.FILE, "message": CompressionMode.MESSAGE, "chunk": CompressionMode.STORAGE}
        if storage.endswith("_zstd"):
            writer.set_compression(modes[storage.split("_")[1]], CompressionFormat.ZSTD)
    with writer:
        fill(Recorder(writer, storage.startswith("ros1")))
    return path


def points_of(k: int) -> np.ndarray:
    return np.random.default_rng(k).normal(size=(50 + k, 3)).astype(np.float32)


def three_clouds(recorder: Recorder) -> None:
    for k in range(3):
        recorder.cloud("/points", START + k * S, points_of(k))
        recorder.transform("/tf", START + k * S, ("map", "base"), (float(k), 0, 0, 0, 0, 0, 1))
    recorder.transform("/tf_static", START, ("base", "lidar"), (0, 0, 1.5, 0, 0, 0, 1))


def messages_of(path: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, reader.deserialize(raw, connection.msgtype)))
    return found
