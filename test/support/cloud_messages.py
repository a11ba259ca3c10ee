"""PointCloud2 messages for tests, of rosbags' classes and of rclpy's, right ones and broken ones."""

from __future__ import annotations

import importlib
import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

FLAVOURS = ("rosbags", "rclpy")
CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}  # PointField datatype -> struct code
FLOAT32, FLOAT64 = 7, 8


@dataclass(frozen=True)
class Field:
    name: str
    offset: int
    datatype: int = FLOAT32
    count: int = 1


@dataclass(frozen=True)
class Cloud:
    """What a message is made of; `dataclasses.replace` makes a broken one of a right one."""

    fields: tuple[Field, ...]
    data: bytes
    point_step: int
    row_step: int
    width: int
    height: int = 1
    is_bigendian: bool = False
    is_dense: bool = True
    stamp_ns: int = 1_500_000_000_250_000_000
    frame_id: str = "lidar"

    def message(self, flavour: str = "rosbags") -> Any:
        """A message of one flavour; skips the test where that flavour is not installed."""
        return _MAKERS[flavour](self)


@dataclass(frozen=True)
class Column:
    """One field of every point: values (N,), PointField datatype, place in the point (packed if not told)."""

    name: str
    values: Sequence[float]
    datatype: int = FLOAT32
    offset: int | None = None
    count: int = 1


@dataclass(frozen=True)
class Layout:
    """How `pack` lays points out; None: as tight as possible."""

    height: int = 1
    point_step: int | None = None
    row_step: int | None = None
    bigendian: bool = False
    filler: int = 0xA5  # padding is not zero, so that a test sees when it is read
    extra: Mapping[str, Any] = field(default_factory=dict)


def pack(columns: Sequence[Column], layout: Layout = Layout()) -> Cloud:
    """Write columns value by value with struct, independently of how the reader reads."""
    order, fields, end = "><"[not layout.bigendian], [], 0
    for column in columns:
        offset = end if column.offset is None else column.offset
        fields.append(Field(column.name, offset, column.datatype, column.count))
        end = max(end, offset + struct.calcsize(CODES[column.datatype]))
    width = len(columns[0].values) // layout.height
    step = layout.point_step or end
    row_step = layout.row_step or width * step
    data = bytearray([layout.filler]) * (row_step * layout.height)
    for i in range(width * layout.height):
        start = i // width * row_step + i % width * step
        for column, f in zip(columns, fields, strict=True):
            struct.pack_into(order + CODES[f.datatype], data, start + f.offset, column.values[i])
    cloud = Cloud(tuple(fields), bytes(data), step, row_step, width, layout.height, layout.bigendian)
    return replace(cloud, **layout.extra)


def xyz_columns(points: ArrayLike, datatype: int = FLOAT32) -> list[Column]:
    """Columns x, y, z of points (N, 3)."""
    rows = np.asarray(points).reshape(-1, 3).T.tolist()
    return [Column(name, values, datatype) for name, values in zip("xyz", rows, strict=True)]


def xyz_cloud(points: ArrayLike, stamp_ns: int = 0, frame_id: str = "lidar") -> Cloud:
    """A plain cloud of FLOAT32 x, y, z, quick for large ones too."""
    data = np.asarray(points, "<f4").reshape(-1, 3)
    fields = tuple(Field(name, 4 * i) for i, name in enumerate("xyz"))
    return Cloud(fields, data.tobytes(), 12, data.nbytes, len(data), stamp_ns=stamp_ns, frame_id=frame_id)


def _rosbags_message(cloud: Cloud) -> Any:
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY).types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(cloud.stamp_ns, 10**9))
    header = types["std_msgs/msg/Header"](stamp, cloud.frame_id)
    point_field = types["sensor_msgs/msg/PointField"]
    fields = [point_field(f.name, f.offset, f.datatype, f.count) for f in cloud.fields]
    data = np.frombuffer(cloud.data, np.uint8)  # read-only, as rosbags gives it
    size, steps = (cloud.height, cloud.width), (cloud.point_step, cloud.row_step)
    make = types["sensor_msgs/msg/PointCloud2"]
    return make(header, *size, fields, cloud.is_bigendian, *steps, data, cloud.is_dense)


def _rclpy_message(cloud: Cloud) -> Any:
    messages = pytest.importorskip("sensor_msgs.msg")
    message = messages.PointCloud2()
    stamp = importlib.import_module("builtin_interfaces.msg").Time()
    stamp.sec, stamp.nanosec = divmod(cloud.stamp_ns, 10**9)
    message.header.stamp, message.header.frame_id = stamp, cloud.frame_id
    message.fields = [
        messages.PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count) for f in cloud.fields
    ]
    message.data = array("B", cloud.data)
    for name in ("height", "width", "point_step", "row_step", "is_bigendian", "is_dense"):
        setattr(message, name, getattr(cloud, name))
    return message


_MAKERS = {"rosbags": _rosbags_message, "rclpy": _rclpy_message}
