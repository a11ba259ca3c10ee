"""What is intact in one file of a recording, found by going through all of it once.

This is for files that their own index does not open: cut, never closed, or damaged. Kept are 40 bytes a message.
"""

from __future__ import annotations

from array import array
from binascii import crc32
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from svc_ros.io.bags.channels import Channel
from svc_ros.io.bags.decompression import decompress

_MAX_TIME_NS = 2**63
_MOST_BYTES = 1 << 32  # of a chunk that does not tell


class Place(NamedTuple):
    """Where a message lies: bytes `offset` to `offset + length` of the chunk at `block`, or of the file where < 0."""

    block: int
    offset: int
    length: int


class Block(NamedTuple):
    """A chunk's bytes in the file, how they are compressed, how many they are without that, and their CRC-32 (0: none).

    size: -1 where the chunk was not closed, and goes on to the end of the file.
    """

    start: int
    length: int
    compression: str
    size: int
    checksum: int = 0


class Found:
    """What a scan came across. causes: what is wrong with the file, in words that follow `FILE: `.

    lost: messages by channel that are known to have been there; is_cut: the file breaks off; is_open: nobody knows what
    else there was; recorded: messages by channel as the index at the file's end counts them, None without a whole one.
    """

    def __init__(self) -> None:
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.lost: Counter[int] = Counter()
        self.causes: list[str] = []
        self.is_cut = self.is_open = False
        self.recorded: Mapping[int, int] | None = None
        self._rows = [array("q") for _ in range(5)]  # time, channel, block, offset, length

    def add(self, channel_id: int, time_ns: int, place: Place) -> None:
        """Take note of a message; ValueError for a time that no clock shows."""
        if not 0 <= time_ns < _MAX_TIME_NS:
            raise ValueError(f"time {time_ns} ns")
        for row, value in zip(self._rows, (time_ns, channel_id, *place), strict=True):
            row.append(value)
        self.counts[channel_id] += 1

    def end_early(self, cause: str) -> None:
        """Take note of where the file breaks off."""
        self.causes.append(cause)
        self.is_cut = self.is_open = True

    def settle(self) -> None:
        """To be called after the last message: channels get their counts, messages without one are lost."""
        if self.recorded is not None:
            self.lost = Counter({key: max(0, num - self.counts[key]) for key, num in self.recorded.items()})
            self.is_open = False
        unknown = sum(count for key, count in self.counts.items() if key not in self.channels)
        if unknown:
            self.causes.append(f"{unknown} messages are of a topic whose name is lost")
        self.channels = {key: channel._replace(num_messages=self.counts[key]) for key, channel in self.channels.items()}

    def span_ns(self) -> tuple[int, int]:
        """First and last time [ns] of a message; the first is later than the last where there is none."""
        times = self._rows[0]
        return (min(times), max(times)) if times else (0, -1)

    def select(self, ids: Collection[int], first_ns: int, last_ns: int) -> Iterator[tuple[int, int, Place]]:
        """Channel, time [ns] and place of messages by time, those of one time as they lie in the file."""
        times, channels = (np.array(row, np.int64) for row in self._rows[:2])
        wanted = np.flatnonzero(np.isin(channels, list(ids)) & (times >= first_ns) & (times <= last_ns))
        blocks, offsets, lengths = self._rows[2:]
        for row in wanted[np.argsort(times[wanted], kind="stable")].tolist():
            yield int(channels[row]), int(times[row]), Place(blocks[row], offsets[row], lengths[row])


class Scan(Protocol):
    """A file that was gone through, and is open to read what was found in it."""

    found: Found

    def read(self, place: Place) -> bytes:
        """The bytes of a message."""

    def close(self) -> None:
        """Close the file."""


class BrokenRecordError(Exception):
    """No record stands where one should; `what` was expected, in a word, empty for anything."""

    def __init__(self, what: str = "") -> None:
        super().__init__(what)
        self.what = what


class RecordScan:
    """A file of records one after the other, messages among them or in chunks; a child knows how they look.

    Where no record stands, the scan goes on with the next chunk that can be told for sure.
    """

    begin = 0  # of the first record

    def __init__(self, path: Path) -> None:
        self.found = Found()
        self.in_chunk: Counter[int] = Counter()  # intact messages of the last chunk, by channel
        self._blocks: dict[int, Block] = {}
        self._is_uncounted = False  # whether the last chunk is damaged, and no index told how much was in it
        self.size = path.stat().st_size
        self.is_over = False
        self._file = path.open("rb")
        self._cached = (-1, b"")
        try:
            self._go_through()
        except BaseException:
            self.close()
            raise

    def take(self, position: int) -> int:
        """Take note of the record at a byte of the file; where the next one is. BrokenRecordError for none."""
        raise NotImplementedError

    def find_chunk(self, position: int) -> int | None:
        """The first place of a chunk from `position` on."""
        raise NotImplementedError

    def finish(self) -> None:
        """Called after the last record."""
        raise NotImplementedError

    def go_through_chunk(self, position: int, data: bytes) -> bool:
        """Take note of the records of a chunk; False where they do not fill it exactly."""
        raise NotImplementedError

    def take_chunk(self, position: int, block: Block) -> int:
        """Take note of a chunk's messages; where the next record is.

        A chunk that is not what its header says is lost as a whole; of one that the file ends in, what is there counts.
        """
        self._blocks[position], self.in_chunk = block, Counter()
        self.found.is_open |= self._is_uncounted
        self._is_uncounted = False
        end, before = block.start + block.length, self.found.counts.copy()
        is_cut = end > self.size
        try:
            data = self._block_bytes(position)
            if not is_cut:
                _check_chunk(block, data)
            fits = self.go_through_chunk(position, data) or block.size < 0
            self.in_chunk = self.found.counts - before
            if not is_cut and not fits:
                raise ValueError("it ends in the middle of a record")
        except (ValueError, MemoryError) as error:
            if not is_cut:
                self.found.causes.append(f"the chunk at byte {position} is damaged: {error}")
                self._is_uncounted = True
        if is_cut:
            self.found.end_early(f"the file ends after {self.size} bytes in the middle of a chunk")
        return min(end, self.size)

    def tell_index(self, channel_id: int, count: int) -> None:
        """Compare with how many messages of a channel the last chunk's index counts."""
        self._is_uncounted = False
        missing = count - self.in_chunk[channel_id]
        if missing > 0:
            self.found.lost[channel_id] += missing

    def _go_through(self) -> None:
        position = self.begin
        while position < self.size and not self.is_over:
            try:
                position = self.take(position)
            except BrokenRecordError as error:
                position = self._after_damage(position, error.what)
        self.found.is_open |= self._is_uncounted
        self.finish()
        self.found.settle()

    def _after_damage(self, position: int, what: str) -> int:
        following = self.find_chunk(position + 1)
        if following is not None:
            self.found.causes.append(f"bytes {position} to {following} are damaged")
            self.found.is_open = True
            return following
        if what:
            self.found.end_early(f"the file ends after {self.size} bytes in the middle of {what}")
        else:
            self.found.end_early(f"its {self.size - position} bytes from byte {position} on are damaged")
        return self.size

    def bytes_at(self, start: int, length: int) -> bytes:
        """Bytes of the file; fewer at its end."""
        self._file.seek(start)
        return self._file.read(max(0, min(length, self.size - start)))

    def _block_bytes(self, position: int) -> bytes:
        """What the chunk at a place holds, as far as it is there; ValueError where it is damaged."""
        if self._cached[0] != position:
            block = self._blocks[position]
            data, most = self.bytes_at(block.start, block.length), block.size if block.size >= 0 else _MOST_BYTES
            self._cached = position, decompress(data, block.compression, most)
        return self._cached[1]

    def read(self, place: Place) -> bytes:
        """The bytes of a message."""
        if place.block < 0:
            return self.bytes_at(place.offset, place.length)
        return self._block_bytes(place.block)[place.offset : place.offset + place.length]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _check_chunk(block: Block, data: bytes) -> None:
    if 0 <= block.size != len(data):
        raise ValueError(f"it holds {len(data)} bytes in place of {block.size}")
    if block.checksum and crc32(data) != block.checksum:
        raise ValueError("its checksum differs")
