"""One file of a recording: read by its index where that holds, else by going through the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.io.bags.channels import Channel
from svc_ros.io.bags.db3_scan import DB3_MAGIC, Db3Scan, unfinished_beside
from svc_ros.io.bags.mcap_scan import MCAP_MAGIC, McapScan
from svc_ros.io.bags.ros1_scan import ROS1_MAGIC, Ros1Scan
from svc_ros.io.bags.scan import Scan

EXPECTED = "expected a .bag, .mcap or .db3 file or a ROS 2 bag folder"
_SCANS: dict[bytes, Callable[[Path], Scan]] = {ROS1_MAGIC: Ros1Scan, MCAP_MAGIC: McapScan, DB3_MAGIC: Db3Scan}
_SUFFIXES = {ROS1_MAGIC: ".bag", MCAP_MAGIC: ".mcap", DB3_MAGIC: ".db3"}
_MAX_TIME_NS = 2**63 - 1
Span = tuple[int, int]
Message = tuple[Channel, int, bytes]


class Part:
    """One open file. path: where its bytes are; name: what the user calls it; on_damage: called when some is found.

    Raises InputError for what is no file of a recording, or cannot be opened at all.
    """

    def __init__(self, path: Path, name: Path, on_damage: Callable[[], None]) -> None:
        self.name = name
        self._path, self._on_damage = path, on_damage
        self._unreadable: dict[str, set[int]] = {}
        self._magic = _magic_of(path, name)
        self._file: _Indexed | _Scanned | None = None
        if (self._magic != ROS1_MAGIC and path.suffix != _SUFFIXES[self._magic]) or unfinished_beside(path):
            self._scan()
            return
        try:
            self._file = _Indexed(path, self._magic == ROS1_MAGIC)
        except MissingDependencyError:
            raise
        except Exception:  # of any type; the scan tells what is wrong
            self._scan()

    @property
    def channels(self) -> Collection[Channel]:
        """All channels, with the number of their intact messages."""
        return self._open_file().channels.values()

    @property
    def span_ns(self) -> Span:
        """First and last time of recording [ns]; (0, -1) without messages."""
        return self._open_file().span_ns

    @property
    def causes(self) -> list[str]:
        """What is wrong with the file, as far as it is known now."""
        found = self._open_file().causes
        return [*found, *(f"{topic} has {len(times)} damaged" for topic, times in self._unreadable.items())]

    def num_lost(self, topic: str) -> int | None:
        """Messages of a topic that were recorded and cannot be read; None where nobody knows."""
        lost = self._open_file().num_lost(topic)
        return None if lost is None else lost + self.num_unreadable(topic)

    def num_unreadable(self, topic: str) -> int:
        """Messages of a topic that are there, and are not what their type says."""
        return len(self._unreadable.get(topic, ()))

    def mark_unreadable(self, topic: str, time_ns: int) -> None:
        """Remember a message that is there, and is not what its type says; the same one may come by again."""
        self._unreadable.setdefault(topic, set()).add(time_ns)
        self._on_damage()

    def messages(self, wanted: Callable[[Channel], bool], span_ns: Span | None = None) -> Iterator[Message]:
        """Channel, time [ns] and bytes of messages by time; from where the index fails on, the scan goes on.

        An index that counts more messages than it leads to has failed, too.
        """
        span = span_ns or (0, _MAX_TIME_NS)
        last_ns, done, left = -1, Counter[str](), self._num_within(wanted, span)
        file = self._open_file()
        try:
            for message in file.messages(wanted, span):
                if message[1] != last_ns:
                    last_ns, done = message[1], Counter()
                done[message[0].topic] += 1
                left -= 1
                yield message
            if left <= 0 or isinstance(file, _Scanned):
                return
        except Exception as error:
            if isinstance(file, _Scanned):
                raise InputError(f"{self.name}: cannot be read any more: it has changed") from error
        if file is self._file:
            self._scan("its index does not fit its messages")
        for message in self._open_file().messages(wanted, (max(last_ns, span[0]), span[1])):
            if message[1] == last_ns and done[message[0].topic] > 0:
                done[message[0].topic] -= 1
                continue
            yield message

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    def _open_file(self) -> _Indexed | _Scanned:
        if self._file is None:
            raise InputError(f"{self.name}: the bag is not open; use it in a `with` block")
        return self._file

    def _num_within(self, wanted: Callable[[Channel], bool], span: Span) -> int:
        """How many messages the index counts; 0 where only a part of the time is asked for."""
        begin, end = self.span_ns
        if span[0] > begin or span[1] < end:
            return 0
        return sum(channel.num_messages for channel in self.channels if wanted(channel))

    def _scan(self, otherwise: str = "") -> None:
        """otherwise: what is wrong with the file, if the scan finds nothing."""
        before = self._file
        try:
            scan = _SCANS[self._magic](self._path)
            if otherwise and not scan.found.causes:
                scan.found.causes.append(otherwise)
            self._file = _Scanned(scan)
        except OSError as error:
            raise InputError(f"{self.name}: cannot be read: {error.strerror or error}") from None
        if before is not None:
            before.close()
        if self._file.causes:
            self._on_damage()


class _Indexed:
    """A file as rosbags reads it."""

    causes: tuple[str, ...] = ()

    def __init__(self, path: Path, is_ros1: bool) -> None:
        reader_of = _reader_class(is_ros1)
        self._reader = reader_of(path)
        self._reader.open()
        from rosbags.interfaces import MessageDefinitionFormat

        idl = MessageDefinitionFormat.IDL
        self._connections = {c.id: c for c in self._reader.connections}
        self.channels = {
            c.id: Channel(c.id, c.topic, c.msgtype, c.msgdef.data, c.msgdef.format == idl, is_ros1, c.msgcount)
            for c in self._reader.connections
        }
        is_empty = not self._reader.message_count
        self.span_ns = (0, -1) if is_empty else (self._reader.start_time, self._reader.end_time - 1)
        counted = sum(channel.num_messages for channel in self.channels.values())
        # Without an index of chunks rosbags takes messages in the order of the file, and refuses any other.
        has_index = is_ros1 or getattr(self._reader.storage, "chunks", None) != []
        if counted != self._reader.message_count or not has_index:
            self._reader.close()
            raise ValueError("no index")

    def num_lost(self, _topic: str) -> int | None:
        return 0

    def messages(self, wanted: Callable[[Channel], bool], span: Span) -> Iterator[Message]:
        chosen = [self._connections[key] for key, channel in self.channels.items() if wanted(channel)]
        if not chosen:  # the reader takes no connections for all of them
            return
        for connection, time_ns, raw in self._reader.messages(chosen, span[0], min(span[1], _MAX_TIME_NS - 1) + 1):
            yield self.channels[connection.id], time_ns, raw

    def close(self) -> None:
        self._reader.close()


class _Scanned:
    """A file that was gone through."""

    def __init__(self, scan: Scan) -> None:
        self._scan, self.channels = scan, scan.found.channels
        self.span_ns, self.causes = scan.found.span_ns(), scan.found.causes

    def num_lost(self, topic: str) -> int | None:
        found = self._scan.found
        if found.is_open:
            return None
        return sum(found.lost[key] for key, channel in self.channels.items() if channel.topic == topic)

    def messages(self, wanted: Callable[[Channel], bool], span: Span) -> Iterator[Message]:
        ids = {key for key, channel in self.channels.items() if wanted(channel)}
        for key, time_ns, place in self._scan.found.select(ids, *span):
            yield self.channels[key], time_ns, self._scan.read(place)

    def close(self) -> None:
        self._scan.close()


def _magic_of(path: Path, name: Path) -> bytes:
    """What the file begins with, among what a recording may begin with."""
    try:
        with path.open("rb") as file:
            begin = file.read(max(map(len, _SCANS)))
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror}") from None
    magic = next((known for known in _SCANS if begin.startswith(known)), None)
    if magic is None:
        found = "it is empty" if not begin else f"it is no bag: {EXPECTED}, found a file that begins with {begin!r}"
        raise InputError(f"{name}: cannot be read as a bag: {found}")
    return magic


def _reader_class(is_ros1: bool) -> Any:
    try:
        from rosbags import rosbag1, rosbag2
    except ImportError:
        raise MissingDependencyError("reading bags needs rosbags: pip install 'rosbags>=0.11'") from None
    return rosbag1.Reader if is_ros1 else rosbag2.Reader
