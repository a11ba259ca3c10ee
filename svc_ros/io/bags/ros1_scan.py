"""A ROS 1 bag (version 2.0) from its first record to its last, without its index; see http://wiki.ros.org/Bags."""

from __future__ import annotations

import re
import struct
from collections import Counter
from pathlib import Path

from svc_ros.core.errors import InputError
from svc_ros.io.bags.channels import Channel, ros2_type_name
from svc_ros.io.bags.decompression import COMPRESSIONS, NONE
from svc_ros.io.bags.scan import Block, BrokenRecordError, Place, RecordScan

ROS1_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_NAMES = {_MESSAGE: "a message", _CHUNK: "a chunk"}
_LONGEST_HEADER = 1 << 16
_LIKELY_CHUNK = re.compile(rb"compression=|op=\x05")
_STEP, _OVERLAP = 1 << 22, 16
Fields = dict[bytes, bytes]


class Ros1Scan(RecordScan):
    """Messages of a ROS 1 bag."""

    begin = len(ROS1_MAGIC)

    def __init__(self, path: Path) -> None:
        self._index_at = self._num_chunks = self._num_infos = 0
        self._counted: Counter[int] = Counter()  # messages by connection, as the index counts them
        super().__init__(path)

    def take(self, position: int) -> int:
        fields, start, length = self._record_at(position)
        op, end = _op(fields), start + length
        if op == _CHUNK:
            return self.take_chunk(position, self._chunk(fields, start, length))
        if end > self.size:
            raise BrokenRecordError("its index" if 0 < self._index_at <= position else _NAMES.get(op, "a record"))
        try:
            self._take_small(op, fields, Place(-1, start, length))
        except (struct.error, ValueError, KeyError):
            raise BrokenRecordError from None
        return end

    def finish(self) -> None:
        if self._num_infos and self._num_infos == self._num_chunks:
            self.found.recorded = self._counted
        if self.found.is_cut:
            return
        if not self._index_at:
            self.found.end_early("its recording was not closed")
        elif self._index_at > self.size:
            self.found.end_early(f"the file ends after {self.size} bytes, before its index")

    def find_chunk(self, position: int) -> int | None:
        while position < self.size:
            data = self.bytes_at(position, _STEP + _OVERLAP)
            for match in _LIKELY_CHUNK.finditer(data):
                at = position + match.start() - 8  # two lengths before the first field
                if at >= position and self._is_chunk(at):
                    return at
            position += _STEP
        return None

    def _is_chunk(self, position: int) -> bool:
        try:
            return _op(self._record_at(position)[0]) == _CHUNK
        except BrokenRecordError:
            return False

    def _record_at(self, position: int) -> tuple[Fields, int, int]:
        """Header of a record, where its data begin, and how long they are."""
        head = self.bytes_at(position, 4)
        length = struct.unpack("<I", head)[0] if len(head) == 4 else 0
        if length > _LONGEST_HEADER:
            raise BrokenRecordError
        data = self.bytes_at(position, 8 + length)
        if len(data) < 8 + length or length == 0:
            raise BrokenRecordError("a record" if len(data) < 8 + length else "")
        return _fields(data[4 : 4 + length]), position + 8 + length, struct.unpack_from("<I", data, 4 + length)[0]

    def _take_small(self, op: int, fields: Fields, place: Place) -> None:
        if op == _MESSAGE:
            self.found.add(_number(fields[b"conn"]), _time_ns(fields[b"time"]), place)
        elif op == _CONNECTION:
            self._describe(fields, self.bytes_at(place.offset, place.length))
        elif op == _INDEX:
            self.tell_index(_number(fields[b"conn"]), _number(fields[b"count"]))
        elif op == _BAG:
            if fields.get(b"encryptor"):
                raise InputError(f"{self._file.name}: cannot be read as a bag: it is encrypted")
            self._index_at = struct.unpack("<Q", fields[b"index_pos"])[0]
            self._num_chunks = _number(fields[b"chunk_count"])
        elif op == _CHUNK_INFO:
            self._num_infos += 1
            for conn, count in struct.iter_unpack("<II", self.bytes_at(place.offset, place.length)):
                self._counted[conn] += count

    def _chunk(self, fields: Fields, start: int, length: int) -> Block:
        """The chunk of a header. BrokenRecordError where its length is damaged: too long, as if the file were cut."""
        compression, size = fields[b"compression"].decode("ascii"), _number(fields[b"size"])
        if length == 0:  # of a recording that was not closed
            return Block(start, self.size - start, compression, -1)
        if start + length > self.size:
            is_cut = length == size if compression in NONE else self.find_chunk(start) is None
            if not is_cut:
                raise BrokenRecordError
        return Block(start, length, compression, size)

    def go_through_chunk(self, position: int, data: bytes) -> bool:
        """Take note of the records of a chunk; False where they do not fill it exactly."""
        at = 0
        try:
            while at < len(data):
                length = struct.unpack_from("<I", data, at)[0]
                start = at + 8 + length
                num_bytes = struct.unpack_from("<I", data, at + 4 + length)[0]
                if start + num_bytes > len(data):
                    return False
                fields = _fields(data[at + 4 : at + 4 + length])
                if _op(fields) == _MESSAGE:
                    place = Place(position, start, num_bytes)
                    self.found.add(_number(fields[b"conn"]), _time_ns(fields[b"time"]), place)
                elif _op(fields) == _CONNECTION:
                    self._describe(fields, data[start : start + num_bytes])
                at = start + num_bytes
        except (struct.error, ValueError, KeyError, BrokenRecordError):
            return False
        return True

    def _describe(self, fields: Fields, data: bytes) -> None:
        """Take note of a connection; the first word on each counts."""
        conn, inner = _number(fields[b"conn"]), _fields(data)
        name, text = inner[b"type"].decode("utf-8", "replace"), inner[b"message_definition"].decode("utf-8", "replace")
        path = fields[b"topic"].decode("utf-8", "replace")
        topic = "/" * path.startswith("/") + "/".join(filter(None, path.split("/")))
        self.found.channels.setdefault(conn, Channel(conn, topic, ros2_type_name(name), text, is_ros1=True))


def _fields(data: bytes) -> Fields:
    """`name=value` pairs of a header; BrokenRecordError where it is none, or is no whole one."""
    fields, at = {}, 0
    while at < len(data):
        end = at + 4 + (struct.unpack_from("<I", data, at)[0] if at + 4 <= len(data) else len(data))
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise BrokenRecordError
        fields[name], at = value, end
    return fields


def _op(fields: Fields) -> int:
    """What a record is; BrokenRecordError where it is nothing, or a chunk without what a chunk needs."""
    value = fields.get(b"op", b"")
    if len(value) != 1 or not _MESSAGE <= value[0] <= _CONNECTION:
        raise BrokenRecordError
    if value[0] == _CHUNK:
        known = fields.get(b"compression", b"?").decode("ascii", "replace") in COMPRESSIONS
        if not known or len(fields.get(b"size", b"")) != 4:
            raise BrokenRecordError
    return value[0]


def _number(value: bytes) -> int:
    return int(struct.unpack("<I", value)[0])


def _time_ns(value: bytes) -> int:
    seconds, rest = struct.unpack("<II", value)
    return int(seconds) * 1_000_000_000 + int(rest)
