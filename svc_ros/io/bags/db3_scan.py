"""An SQLite file of rosbag2 row by row, with what its recording left beside it; the file itself is never changed."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from svc_ros.core.errors import InputError
from svc_ros.io.bags.channels import Channel
from svc_ros.io.bags.scan import Found, Place

DB3_MAGIC = b"SQLite format 3\0"
_LARGEST_ID = 2**63 - 1
_IDL = "ros2idl"


def unfinished_beside(path: Path) -> list[Path]:
    """What SQLite keeps beside a file that was not closed: a log of what is not in it yet, or a journal to undo."""
    beside = [path.with_name(path.name + end) for end in ("-wal", "-journal")]
    return [file for file in beside if file.is_file() and file.stat().st_size]


class Db3Scan:
    """Messages of an SQLite file, in the order of their numbers. Rows that cannot be read are left out."""

    def __init__(self, path: Path) -> None:
        self.found = Found()
        self._path, self._size = path, path.stat().st_size
        self._file = _connect(path)
        try:
            self._describe()
            self._go_through()
        except BaseException:
            self.close()
            raise
        self.found.settle()

    def read(self, place: Place) -> bytes:
        """The bytes of a message."""
        row = self._file.execute("SELECT data FROM messages WHERE id = ?", (place.offset,)).fetchone()
        return b"" if row is None else bytes(row[0])

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _describe(self) -> None:
        definitions: dict[str, tuple[str, str]] = {}
        with suppress(sqlite3.Error, ValueError):  # older files have none
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            definitions = {str(name): (str(text), str(how)) for name, how, text in self._file.execute(query)}
        try:
            for key, topic, name in self._file.execute("SELECT id, name, type FROM topics"):
                text, encoding = definitions.get(str(name), ("", ""))
                self.found.channels[int(key)] = Channel(int(key), str(topic), str(name), text, encoding == _IDL)
            self._file.execute("SELECT id, topic_id, timestamp, data FROM messages LIMIT 0")
        except (sqlite3.Error, ValueError, TypeError, MemoryError):
            what = "it is no recording of ROS 2, or damaged: expected tables of topics and messages"
            raise InputError(f"{self._path}: cannot be read as a bag: {what}{self._size_told()}") from None

    def _go_through(self) -> None:
        last, num_lost = 0, 0
        while True:
            last, is_end = self._read_on(last)
            if is_end:
                break
            following = self._first_readable(last)
            if following is None:
                self.found.end_early(f"its rows after message {last} are damaged{self._size_told()}")
                return
            num_lost += following - last - 1
            last = following - 1
        if num_lost:
            self.found.causes.append(f"{num_lost} rows of messages are damaged{self._size_told()}")
            self.found.is_open = True  # of which topics they were, nobody knows
        elif self._size_told():
            self.found.causes.append(self._size_told().removeprefix(": "))
        if any(file.name.endswith("-journal") for file in unfinished_beside(self._path)):
            self.found.causes.append(f"its last transaction was not finished ({self._path.name}-journal)")

    def _read_on(self, last: int) -> tuple[int, bool]:
        """Take note of messages after number `last`; the last one that could be read, and whether that is the end."""
        query = (
            "SELECT id, topic_id, timestamp, CASE WHEN length(data) <= ? THEN data END FROM messages "
            "WHERE id > ? ORDER BY id"
        )
        try:
            for key, topic, time_ns, data in self._file.execute(query, (self._most_bytes(), last)):
                if not isinstance(key, int) or key <= last:  # a damaged tree can lead in a circle
                    return last, False
                last = key
                if isinstance(data, bytes) and isinstance(topic, int) and isinstance(time_ns, int):
                    with suppress(ValueError):
                        self.found.add(topic, time_ns, Place(-1, key, len(data)))
                        continue
                self.found.causes.append(f"row {key} of its messages is damaged")
                self.found.lost[topic] += 1
        except (sqlite3.Error, MemoryError):
            return last, False
        return last, True

    def _most_bytes(self) -> int:
        """No message is longer than all files together, whatever a damaged row says."""
        return self._size + sum(file.stat().st_size for file in unfinished_beside(self._path))

    def _first_readable(self, last: int) -> int | None:
        """The first number after a gap behind `last`, found by doubling and halving the step; None without any."""
        low, step = last + 1, 1
        while (found := self._next_id(last + step)) is None:
            low, step = last + step, 2 * step
            if last + step > _LARGEST_ID:
                return None
        high = last + step
        while high - low > 1:
            middle = (low + high) // 2
            if (nearer := self._next_id(middle)) is None:
                low = middle
            else:
                high, found = middle, nearer
        return found

    def _next_id(self, above: int) -> int | None:
        """The first number after `above` whose row can be read; None where it cannot, or there is none."""
        query = "SELECT id, CASE WHEN length(data) <= ? THEN data END FROM messages WHERE id > ? ORDER BY id LIMIT 1"
        try:
            row = self._file.execute(query, (self._most_bytes(), above)).fetchone()
        except (sqlite3.Error, MemoryError):
            return None
        return int(row[0]) if row is not None and isinstance(row[0], int) and row[0] > above else None

    def _size_told(self) -> str:
        """How much of the file is missing, by its own header; empty where nothing is."""
        with self._path.open("rb") as file:
            head = file.read(100)
        if len(head) < 100:
            return f": the file ends after {self._size} bytes"
        page, pages = struct.unpack_from(">H", head, 16)[0], struct.unpack_from(">I", head, 28)[0]
        whole = (65536 if page == 1 else page) * pages
        return f": the file ends after {self._size} of {whole} bytes" if self._size < whole else ""


def _connect(path: Path) -> sqlite3.Connection:
    """Opened so that no file beside it is made or changed: a log is read with an index in memory and without locks."""
    has_log = any(file.name.endswith("-wal") for file in unfinished_beside(path))
    how = "mode=ro&vfs=unix-none" if has_log else "mode=ro&immutable=1"
    connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?{how}", uri=True, check_same_thread=False)
    connection.text_factory = lambda data: data.decode("utf-8", "replace")
    with suppress(sqlite3.Error):  # the first look at a damaged file may fail; the next one tells
        connection.execute("PRAGMA locking_mode=EXCLUSIVE")
        connection.execute("PRAGMA writable_schema=ON")  # a file that was cut opens at all
    return connection
