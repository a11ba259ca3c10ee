"""Livox' own message for tests: serialised, as an object a point, and its package where the driver is not installed."""

from __future__ import annotations

import ctypes
import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import pytest

LIVOX_TYPE = "livox_ros_driver2/msg/CustomMsg"
_DEFINITIONS = {
    "livox_ros_driver2/msg/CustomPoint": (
        "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
    ),
    LIVOX_TYPE: (
        "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
        "livox_ros_driver2/CustomPoint[] points\n"
    ),
}


@dataclass(frozen=True)
class LivoxScan:
    """What a message is made of: points (N, 3) [m], times (N,) [ns] after the stamp."""

    points: Any
    times_ns: Sequence[int]
    stamp_ns: int = 1_700_000_000_250_000_000
    frame_id: str = "livox_frame"

    def message(self) -> Any:
        """Of rosbags' class, an object a point."""
        types = livox_types().types
        stamp = types["builtin_interfaces/msg/Time"](*divmod(self.stamp_ns, 10**9))
        header = types["std_msgs/msg/Header"](stamp, self.frame_id)
        point = types["livox_ros_driver2/msg/CustomPoint"]
        rows = zip(np.asarray(self.points, np.float32).tolist(), self.times_ns, strict=True)
        points = [point(int(t), *xyz, k % 256, 16, k % 4) for k, (xyz, t) in enumerate(rows)]
        return types[LIVOX_TYPE](header, self.stamp_ns, len(points), 3, np.zeros(3, np.uint8), points)

    def cdr(self, little_endian: bool = True) -> bytes:
        """As it is sent, written by rosbags."""
        return bytes(livox_types().serialize_cdr(self.message(), LIVOX_TYPE, little_endian=little_endian))


def livox_types() -> Any:
    """rosbags' types, with those of Livox' driver."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def fast_cdr(points: Any, times_ns: Any, stamp_ns: int, frame_id: str = "livox_frame") -> bytes:
    """The same bytes for many points, packed at once."""
    rows = np.zeros(len(points), np.dtype([("t", "<u4"), ("xyz", "<f4", 3), ("rest", "u1", 3), ("filler", "u1")]))
    rows["t"], rows["xyz"] = times_ns, points
    name = frame_id.encode() + b"\0"
    head = struct.pack("<iII", *divmod(stamp_ns, 10**9), len(name)) + name
    head += bytes(-len(head) % 8) + struct.pack("<QIB3xI", stamp_ns, len(rows), 0, len(rows))
    return b"\0\1\0\0" + head + rows.tobytes()[:-1]


def install_livox_package(patch: pytest.MonkeyPatch) -> Any:
    """Make `livox_ros_driver2.msg.CustomMsg` importable and return it: a type for serialised messages only.

    Generated type support cannot be installed without a ROS. This one is PointCloud2's under Livox' name, which is all
    that the middleware asks for where nobody converts a message.
    """
    package, messages = ModuleType("livox_ros_driver2"), ModuleType("livox_ros_driver2.msg")
    messages.CustomMsg = _named_type()
    package.msg = messages
    patch.setitem(sys.modules, "livox_ros_driver2", package)
    patch.setitem(sys.modules, "livox_ros_driver2.msg", messages)
    return messages.CustomMsg


class _Support(ctypes.Structure):
    """rosidl_message_type_support_t."""

    _fields_ = (
        ("identifier", ctypes.c_void_p), ("data", ctypes.c_void_p), ("handle", ctypes.c_void_p),
        ("hash", ctypes.c_void_p), ("description", ctypes.c_void_p), ("sources", ctypes.c_void_p),
    )  # fmt: skip


_Callbacks = ctypes.c_void_p * 7  # message_type_support_callbacks_t: namespace, name, functions
_Find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_FASTRTPS = b"rosidl_typesupport_fastrtps_c"
_kept: list[Any] = []  # the middleware keeps pointers to them


def _named_type() -> Any:
    from sensor_msgs.msg import PointCloud2

    base = type(PointCloud2)
    base.__import_type_support__()
    get, new = ctypes.pythonapi.PyCapsule_GetPointer, ctypes.pythonapi.PyCapsule_New
    get.restype, get.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
    new.restype, new.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    general_at = get(base._TYPE_SUPPORT, None)
    find = _Find(_Support.from_address(general_at).handle)
    support = _Support.from_buffer_copy(_Support.from_address(find(general_at, _FASTRTPS)))
    names = [ctypes.create_string_buffer(text) for text in (b"livox_ros_driver2::msg", b"CustomMsg")]
    callbacks = _Callbacks(*(ctypes.addressof(name) for name in names), *_Callbacks.from_address(support.data)[2:])

    def answer(_support: int, identifier: bytes) -> int | None:
        return ctypes.addressof(support) if identifier == _FASTRTPS else find(general_at, identifier)

    handle = _Find(answer)
    support.data, support.handle = ctypes.addressof(callbacks), ctypes.cast(handle, ctypes.c_void_p).value
    _kept.extend((names, callbacks, handle, support, find))
    capsule = new(ctypes.addressof(support), None, None)
    return type(base)("Metaclass_CustomMsg", (base,), {"_TYPE_SUPPORT": capsule})("CustomMsg", (), {"__slots__": ()})
