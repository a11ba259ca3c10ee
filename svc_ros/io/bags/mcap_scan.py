"""An MCAP file from its first record to its last, without its index; see https://mcap.dev/spec."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from svc_ros.io.bags.channels import Channel, ros2_type_name
from svc_ros.io.bags.decompression import COMPRESSIONS
from svc_ros.io.bags.scan import Block, BrokenRecordError, Place, RecordScan

MCAP_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _STATISTICS, _DATA_END = 2, 3, 4, 5, 6, 7, 11, 15
_FIRST_PRIVATE = 0x80  # operations that anyone may define; those between are of no version yet
_NAMES = {_MESSAGE: "a message", _CHUNK: "a chunk"}
_RECORD, _MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), struct.Struct("<QQQII")
_LONGEST_NAME = 8  # of a compression
_LONGEST_CHUNK_HEAD = _RECORD.size + _CHUNK_HEAD.size + _LONGEST_NAME + 8
_INDEX_ENTRY = 16  # bytes
_STEP = 1 << 22
_IDL = ("ros2idl", "omgidl")


class McapScan(RecordScan):
    """Messages of an MCAP file."""

    begin = len(MCAP_MAGIC)

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, encoding, text
        self._has_data_end = False
        super().__init__(path)

    def take(self, position: int) -> int:
        head = self.bytes_at(position, _RECORD.size)
        if len(head) < _RECORD.size:
            raise BrokenRecordError(self._place_in_file(0))
        op, length = _RECORD.unpack(head)
        start, end = position + _RECORD.size, position + _RECORD.size + length
        if not _is_operation(op):
            raise BrokenRecordError
        if op == _CHUNK:
            block = self._chunk_at(position)
            if block is None:
                raise BrokenRecordError("a chunk" if self.size - position < _LONGEST_CHUNK_HEAD else "")
            return self.take_chunk(position, block)
        if end > self.size:
            raise BrokenRecordError(self._place_in_file(op))
        try:
            self._take_small(op, start, length)
        except (struct.error, ValueError):
            raise BrokenRecordError from None
        return int(end)

    def finish(self) -> None:
        if not self._has_data_end and not self.found.is_cut:
            self.found.end_early(f"the file ends after {self.size} bytes, before its index")

    def find_chunk(self, position: int) -> int | None:
        while position < self.size:
            data = np.frombuffer(self.bytes_at(position, _STEP + _RECORD.size), np.uint8)
            if len(data) < _RECORD.size:
                return None
            last = len(data) - _RECORD.size + 1
            # Lengths below 2^40: three zeros behind the operation leave few places to look at.
            high = data[6 : last + 6] | data[7 : last + 7] | data[8 : last + 8]
            is_likely = (data[:last] == _CHUNK) & (high == 0)
            for at in np.flatnonzero(is_likely).tolist():
                if self._chunk_at(position + at) is not None:
                    return int(position + at)
            position += last
        return None

    def _place_in_file(self, op: int) -> str:
        return "its index" if self._has_data_end else _NAMES.get(op, "a record")

    def _take_small(self, op: int, start: int, length: int) -> None:
        if op == _MESSAGE:
            self._take_message(self.bytes_at(start, _MESSAGE_HEAD.size), Place(-1, start, length))
        elif op in (_SCHEMA, _CHANNEL):
            self._describe(op, self.bytes_at(start, length))
        elif op == _MESSAGE_INDEX:
            channel_id, num_bytes = struct.unpack("<HI", self.bytes_at(start, 6))
            self.tell_index(channel_id, num_bytes // _INDEX_ENTRY)
        elif op == _STATISTICS:
            data = self.bytes_at(start, length)
            self.found.recorded = dict(struct.iter_unpack("<HQ", data[46 : 46 + struct.unpack_from("<I", data, 42)[0]]))
        self._has_data_end |= op == _DATA_END
        self.is_over |= op == _FOOTER

    def _take_message(self, head: bytes, place: Place) -> None:
        channel_id, _, time_ns, _ = _MESSAGE_HEAD.unpack(head)
        size = _MESSAGE_HEAD.size
        self.found.add(channel_id, time_ns, Place(place.block, place.offset + size, place.length - size))

    def _chunk_at(self, position: int) -> Block | None:
        """The chunk that begins here, if one does: the lengths in its header have to agree."""
        data = self.bytes_at(position + _RECORD.size, _CHUNK_HEAD.size + _LONGEST_NAME + 8)
        if len(data) < _CHUNK_HEAD.size + 8:
            return None
        _, _, size, checksum, length = _CHUNK_HEAD.unpack_from(data)
        start = _CHUNK_HEAD.size + length
        if length > _LONGEST_NAME or start + 8 > len(data):
            return None
        name = data[_CHUNK_HEAD.size : start].decode("ascii", "replace")
        num_bytes = struct.unpack_from("<Q", data, start)[0]
        told = struct.unpack("<Q", self.bytes_at(position + 1, 8))[0]
        if name not in COMPRESSIONS or told != start + 8 + num_bytes:
            return None
        return Block(position + _RECORD.size + start + 8, num_bytes, name, size, checksum)

    def go_through_chunk(self, position: int, data: bytes) -> bool:
        """Take note of the records of a chunk; False where they do not fill it exactly."""
        at = 0
        while at + _RECORD.size <= len(data):
            op, length = _RECORD.unpack_from(data, at)
            start, end = at + _RECORD.size, at + _RECORD.size + length
            if end > len(data) or not _is_operation(op):
                return False
            try:
                if op == _MESSAGE:
                    head = data[start : min(end, start + _MESSAGE_HEAD.size)]
                    self._take_message(head, Place(position, start, length))
                elif op in (_SCHEMA, _CHANNEL):
                    self._describe(op, data[start:end])
            except (struct.error, ValueError):
                return False
            at = end
        return at == len(data)

    def _describe(self, op: int, data: bytes) -> None:
        """Take note of a schema or of a channel; the first word on each counts."""
        key, at = struct.unpack_from("<H", data)[0], 2
        if op == _SCHEMA:
            name, at = _text(data, at)
            encoding, at = _text(data, at)
            self._schemas.setdefault(key, (name, encoding, _text(data, at)[0]))
            return
        schema = struct.unpack_from("<H", data, at)[0]
        topic, at = _text(data, at + 2)
        is_ros1 = _text(data, at)[0] == "ros1"
        name, encoding, definition = self._schemas.get(schema, ("", "", ""))
        channel = Channel(key, topic, ros2_type_name(name), definition, encoding in _IDL, is_ros1)
        self.found.channels.setdefault(key, channel)


def _is_operation(op: int) -> bool:
    return 0 < op <= _DATA_END or op >= _FIRST_PRIVATE


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A string and where it ends."""
    start = at + 4
    end = start + struct.unpack_from("<I", data, at)[0]
    if end > len(data):
        raise ValueError("a text is cut")
    return data[start:end].decode("utf-8", "replace"), end  # definitions of other encodings are no text
