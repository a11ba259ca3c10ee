"""All files of a bag, open at once, and what is known of their damage."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from heapq import merge
from pathlib import Path

from svc_ros.core.errors import InputError
from svc_ros.io.bags.channels import Channel, Damage, TopicShare
from svc_ros.io.bags.decompression import ZSTD_MAGIC, unpack_file
from svc_ros.io.bags.files import find_recording
from svc_ros.io.bags.part import Part, Span

_CUT_PACKING = "its compression is cut or damaged"


class OpenParts:
    """The parts of a bag. A file that cannot be opened is damage where there are others.

    strict: any damage is an InputError, as soon as it is known. told: types whose topics damage is told of.
    """

    def __init__(self, paths: Sequence[Path], strict: bool, told: Collection[str]) -> None:
        self.parts: list[Part] = []
        self._told, self._causes = told, list[tuple[Path, str]]()
        self._recorded: Counter[str] = Counter()
        self._is_recorded = True  # by a metadata.yaml for every path
        self._raises = False
        with ExitStack() as stack:
            files = [file for path in paths for file in self._files_of(path)]
            for file in files:
                self._open(file, stack, len(files) == 1)
            self._check_not_all_is_lost(paths)
            self._raises = strict
            self._on_damage()
            self._stack = stack.pop_all()

    @property
    def damage(self) -> list[Damage]:
        """What is known by now; more may come to light while messages are read."""
        causes: dict[Path, list[str]] = {}
        for name, cause in [*self._causes, *((part.name, cause) for part in self.parts for cause in part.causes)]:
            causes.setdefault(name, []).append(cause)
        if not causes:
            return []
        topics = tuple(self._share(name) for name in self._topics_told())
        return [Damage(name, tuple(found), topics) for name, found in causes.items()]

    def channels(self) -> Iterator[Channel]:
        """The channels of all parts."""
        for part in self.parts:
            yield from part.channels

    def messages(
        self, wanted: Callable[[Channel], bool], span_ns: Span | None = None
    ) -> Iterator[tuple[Part, Channel, int, bytes]]:
        """Messages of all parts by time; a part is not touched before its time has come."""

        def of(part: Part) -> Iterator[tuple[int, Part, Channel | None, bytes]]:
            yield part.span_ns[0], part, None, b""
            for channel, time_ns, raw in part.messages(wanted, span_ns):
                yield time_ns, part, channel, raw

        for time_ns, part, channel, raw in merge(*map(of, self.parts), key=lambda item: item[0]):
            if channel is not None:
                yield part, channel, time_ns, raw

    def close(self) -> None:
        """Close all files."""
        self._stack.close()

    def _files_of(self, path: Path) -> list[Path]:
        try:
            recording = find_recording(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        self._causes += recording.causes
        self._recorded.update(recording.recorded)
        self._is_recorded &= bool(recording.recorded)
        return recording.files

    def _open(self, file: Path, stack: ExitStack, is_only: bool) -> None:
        try:
            part = Part(self._unpacked(file, stack), file, self._on_damage)
        except InputError as error:
            if is_only:
                raise
            self._causes.append((file, str(error).removeprefix(f"{file}: ")))
            self._is_recorded &= bool(self._recorded)
            return
        stack.callback(part.close)
        self.parts.append(part)

    def _unpacked(self, file: Path, stack: ExitStack) -> Path:
        """Where the file's bytes are without the compression of whole files."""
        try:
            with file.open("rb") as source:
                is_packed = source.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
            if not is_packed:
                return file
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="svc_ros_"))
            unpacked = Path(folder, file.stem)
            is_whole = unpack_file(file, unpacked)
            if not is_whole:
                self._causes.append((file, _CUT_PACKING))
            if not is_whole and not unpacked.stat().st_size:
                raise InputError(f"{file}: cannot be read as a bag: {_CUT_PACKING}, and nothing in it is intact")
            return unpacked
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror}") from None

    def _on_damage(self) -> None:
        if self._raises and (damage := self.damage):
            raise InputError(f"{damage[0]}; refused, as strict demands")

    def _check_not_all_is_lost(self, paths: Sequence[Path]) -> None:
        held = Counter({channel.topic: 0 for channel in self.channels()})
        for channel in self.channels():
            held[channel.topic] += channel.num_messages
        if not self._causes and not any(part.causes for part in self.parts):
            fewer = [name for name, count in self._recorded.items() if held[name] < count]
            if fewer and self._is_recorded:
                self._causes.append((paths[0], f"its metadata.yaml counts more messages of {', '.join(fewer)}"))
        if not held.total() and (damage := self.damage):
            listed = "; ".join(f"{one.path}: {', '.join(one.causes)}" for one in damage)
            raise InputError(f"{listed}; cannot be read as a bag: no message in it is intact")

    def _topics_told(self) -> list[str]:
        """Topics that somebody may want to read; where there are none, all of them."""
        channels = sorted(self.channels(), key=lambda channel: channel.topic)
        chosen = [channel for channel in channels if channel.type in self._told] or channels
        return list(dict.fromkeys(channel.topic for channel in chosen))

    def _share(self, topic: str) -> TopicShare:
        num_read = sum(channel.num_messages for channel in self.channels() if channel.topic == topic)
        num_read -= sum(part.num_unreadable(topic) for part in self.parts)
        if self._is_recorded and self._recorded[topic] >= num_read:
            return TopicShare(topic, num_read, self._recorded[topic])
        lost = [part.num_lost(topic) for part in self.parts]
        is_known = not self._causes and None not in lost
        return TopicShare(topic, num_read, num_read + sum(filter(None, lost)) if is_known else None)
