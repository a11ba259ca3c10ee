"""Two streams of stamped items become pairs, by stamp.

A source and a target belong together if their stamps differ by at most `max_skew_ns`. Among the possible pairs the
one with the smallest difference is made first, then the next smallest of what is left, and so on: one to one, ties
go to the earlier stamp. That set of pairs is unique, so it does not depend on how the two streams interleave, as long
as each stream is in its own order and no bound is hit.

When an item leaves the pairer:
- **a pair with equal stamps**: at once, when the second of both arrives;
- **any other pair**: as soon as both streams have moved on far enough that no nearer partner can still come for
  either side (a stream's next stamp is not earlier than its last one);
- **alone, `time_skew`**: when the other stream has moved past `stamp + max_skew` and left no partner;
- **alone, `superseded`**: when more than `capacity` items of its stream wait (the other stream is silent);
- **alone, `stale`**: when its stream, or the other, jumps back in time (a bag starts again) and the item belongs to
  the time before, or when `clear` is called.

A stamp that is earlier than its stream's last one by more than `max_skew_ns` is a jump back in time. A smaller step
back is counted as `late` and paired with what still waits.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

from svc_ros.core.errors import ConfigError
from svc_ros.core.result import Reason

Item = TypeVar("Item")
Side = Literal["source", "target"]


@dataclass(frozen=True)
class Matched(Generic[Item]):
    """A source and a target that belong together."""

    source_stamp_ns: int
    target_stamp_ns: int
    source: Item
    target: Item


@dataclass(frozen=True)
class Unmatched(Generic[Item]):
    """An item that left without a partner, and why (time_skew, superseded, stale)."""

    side: Side
    stamp_ns: int
    item: Item
    reason: Reason
    detail: str


@dataclass(order=True)
class _Waiting(Generic[Item]):
    stamp_ns: int
    number: int  # of arrival in its stream: equal stamps keep their order
    item: Item = field(compare=False)


@dataclass
class _Stream(Generic[Item]):
    waiting: list[_Waiting[Item]] = field(default_factory=list)  # sorted by stamp
    last_ns: int | None = None
    num_received: int = 0

    def passed(self, stamp_ns: int) -> bool:
        """True if no later arrival can have a stamp before `stamp_ns`."""
        return self.last_ns is not None and self.last_ns >= stamp_ns


Event = Matched[Item] | Unmatched[Item]


class StampPairer(Generic[Item]):
    """Pairs two streams by stamp; every item that goes in comes out in exactly one event.

    max_skew_ns: largest difference of the two stamps of a pair [ns]; capacity: most items of a stream that wait.
    Not safe for use from several threads at once.
    """

    def __init__(self, max_skew_ns: int, capacity: int = 32) -> None:
        if max_skew_ns < 0 or capacity < 1:
            raise ConfigError(f"pairing: expected max_skew_ns >= 0 and capacity >= 1, found {max_skew_ns}, {capacity}")
        self.max_skew_ns, self.capacity = max_skew_ns, capacity
        self.num_matched = self.num_unmatched = self.num_late = 0
        self._streams: dict[Side, _Stream[Item]] = {"source": _Stream(), "target": _Stream()}

    @property
    def num_waiting(self) -> int:
        """Items of both streams that have neither a partner nor an answer yet."""
        return sum(len(stream.waiting) for stream in self._streams.values())

    @property
    def num_received(self) -> int:
        """Items of both streams so far: twice `num_matched`, plus `num_unmatched`, plus `num_waiting`."""
        return sum(stream.num_received for stream in self._streams.values())

    def add_source(self, stamp_ns: int, item: Item) -> list[Event[Item]]:
        """Take the next source; returns what is decided by its arrival, oldest first."""
        return self._add("source", stamp_ns, item)

    def add_target(self, stamp_ns: int, item: Item) -> list[Event[Item]]:
        """Take the next target; returns what is decided by its arrival, oldest first."""
        return self._add("target", stamp_ns, item)

    def flush(self) -> list[Event[Item]]:
        """Answer everything that waits, as if both streams had ended."""
        events = list(self._match(final=True))
        for side in self._streams:
            for entry in self._take_all(side):
                events.append(self._unmatched(side, entry, Reason.TIME_SKEW, self._skew_text(side)))
        return events

    def clear(self) -> list[Event[Item]]:
        """Forget both streams and their clocks; what waited is returned as `stale`."""
        events: list[Event[Item]] = [
            self._unmatched(side, entry, Reason.STALE, f"the {side} waited when the pairing was cleared")
            for side in self._streams
            for entry in self._take_all(side)
        ]
        for stream in self._streams.values():
            stream.last_ns = None
        return events

    def _add(self, side: Side, stamp_ns: int, item: Item) -> list[Event[Item]]:
        stream = self._streams[side]
        events = self._step_back(stream, stamp_ns)
        stream.last_ns = stamp_ns if stream.last_ns is None else max(stream.last_ns, stamp_ns)
        stream.num_received += 1
        insort(stream.waiting, _Waiting(stamp_ns, stream.num_received, item))
        events += [*self._match(), *self._expire(), *self._shrink(side)]
        return events

    def _step_back(self, stream: _Stream[Item], stamp_ns: int) -> list[Event[Item]]:
        """Handle a stamp that is earlier than its stream's last one."""
        if stream.last_ns is None or stamp_ns >= stream.last_ns:
            return []
        if stamp_ns >= stream.last_ns - self.max_skew_ns:
            self.num_late += 1
            return []
        # Only what lies after the new time is old: the other stream may have jumped first and be waiting already.
        horizon = stamp_ns + self.max_skew_ns
        events: list[Event[Item]] = []
        for side, other in self._streams.items():
            old = [entry for entry in other.waiting if entry.stamp_ns > horizon]
            other.waiting = [entry for entry in other.waiting if entry.stamp_ns <= horizon]
            if other.last_ns is not None and other.last_ns > horizon:
                other.last_ns = None
            events += [self._unmatched(side, e, Reason.STALE, "the stamps jumped back in time") for e in old]
        return events

    def _match(self, final: bool = False) -> Iterator[Event[Item]]:
        """Take out every pair that no later arrival can improve, smallest difference first."""
        sources, targets = self._streams["source"], self._streams["target"]
        while (pair := self._next_pair(final)) is not None:
            source, target = pair
            sources.waiting.remove(source)
            targets.waiting.remove(target)
            self.num_matched += 1
            yield Matched(source.stamp_ns, target.stamp_ns, source.item, target.item)

    def _next_pair(self, final: bool) -> tuple[_Waiting[Item], _Waiting[Item]] | None:
        """The best pair of the waiting items, if it is certain; a less good one that shares no side with a better."""
        candidates = sorted(
            (abs(s.stamp_ns - t.stamp_ns), s, t)
            for s in self._streams["source"].waiting
            for t in self._streams["target"].waiting
            if abs(s.stamp_ns - t.stamp_ns) <= self.max_skew_ns
        )
        sources_seen, targets_seen = set(), set()
        for skew, source, target in candidates:
            best_of_both = source.number not in sources_seen and target.number not in targets_seen
            if best_of_both and (final or self._is_certain(skew, source, target)):
                return source, target
            sources_seen.add(source.number)
            targets_seen.add(target.number)
        return None

    def _is_certain(self, skew: int, source: _Waiting[Item], target: _Waiting[Item]) -> bool:
        if skew == 0:
            return True
        return self._streams["target"].passed(source.stamp_ns + skew) and self._streams["source"].passed(
            target.stamp_ns + skew
        )

    def _expire(self) -> Iterator[Event[Item]]:
        """Take out the items whose partner can no longer come; one that still has a candidate waits on."""
        for side, stream in self._streams.items():
            other = self._streams["target" if side == "source" else "source"]
            for entry in list(stream.waiting):
                hopeless = other.passed(entry.stamp_ns + self.max_skew_ns + 1)
                if hopeless and not self._has_candidate(entry, other):
                    stream.waiting.remove(entry)
                    yield self._unmatched(side, entry, Reason.TIME_SKEW, self._skew_text(side))

    def _has_candidate(self, entry: _Waiting[Item], other: _Stream[Item]) -> bool:
        return any(abs(entry.stamp_ns - o.stamp_ns) <= self.max_skew_ns for o in other.waiting)

    def _shrink(self, side: Side) -> Iterator[Event[Item]]:
        stream = self._streams[side]
        while len(stream.waiting) > self.capacity:
            entry = stream.waiting.pop(0)
            detail = f"more than {self.capacity} newer {side}s wait for a partner"
            yield self._unmatched(side, entry, Reason.SUPERSEDED, detail)

    def _take_all(self, side: Side) -> list[_Waiting[Item]]:
        taken, self._streams[side].waiting = self._streams[side].waiting, []
        return taken

    def _unmatched(self, side: Side, entry: _Waiting[Item], reason: Reason, detail: str) -> Unmatched[Item]:
        self.num_unmatched += 1
        return Unmatched(side, entry.stamp_ns, entry.item, reason, detail)

    def _skew_text(self, side: Side) -> str:
        other = "target" if side == "source" else "source"
        return f"no {other} within {self.max_skew_ns / 1e9:g} s of this {side}"
