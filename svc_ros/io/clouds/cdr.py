"""The first fields of a serialised ROS 2 message, read without a message class: what stamp and frame it has."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from svc_ros.core.errors import UnsupportedCloudError

_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # plain CDR, as ROS 2 sends it
_ORIGIN = 4  # what the alignment counts from: the byte after the encapsulation's own four


class CdrStamp(NamedTuple):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class CdrHeader(NamedTuple):
    """std_msgs/Header."""

    stamp: CdrStamp
    frame_id: str


class CdrReader:
    """Reads values one after the other; `position` is the byte that follows. data: all bytes of one message.

    Raises UnsupportedCloudError where it is no plain CDR, or ends too early.
    """

    def __init__(self, data: bytes) -> None:
        self.byte_order = _ORDERS.get(bytes(data[:2]), "")
        if not self.byte_order:
            raise UnsupportedCloudError(f"expected plain CDR, found a message that begins with {bytes(data[:4])!r}")
        self._data, self.position = data, _ORIGIN

    def header(self) -> CdrHeader:
        """The header that a stamped message begins with."""
        sec, nanosec, length = self.value("i"), self.value("I"), self.value("I")
        end = self.position + length
        if end > len(self._data):
            raise self._too_short(end)
        text = bytes(self._data[self.position : end]).rstrip(b"\0")
        self.position = end
        return CdrHeader(CdrStamp(sec, nanosec), text.decode("utf-8", "replace"))

    def value(self, code: str) -> Any:
        """One number of a `struct` code, from the next place where such a number may stand."""
        size = struct.calcsize(f"={code}")
        start = self.position + (_ORIGIN - self.position) % size
        if start + size > len(self._data):
            raise self._too_short(start + size)
        self.position = start + size
        return struct.unpack_from(self.byte_order + code, self._data, start)[0]

    def _too_short(self, needed: int) -> UnsupportedCloudError:
        return UnsupportedCloudError(f"truncated message: expected at least {needed} bytes, found {len(self._data)}")
