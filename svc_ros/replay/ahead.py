"""Stages of a replay side by side: the next item is made while the last one is used."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterable, Iterator
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")

_POLL_S = 0.1  # how soon a thread that waits for room notices that nobody will take the item


def ahead(items: Iterable[Item], num: int = 2) -> Iterator[Item]:
    """Yield the same items in the same order, made in a thread of their own, at most `num` before they are asked for.

    An exception is raised where its item would have come. The thread ends with the iteration, or when that is closed.
    """
    maker = _Maker(items, num)
    maker.thread.start()
    try:
        yield from maker.made()
    finally:
        maker.stop()


class _Maker(Generic[Item]):
    def __init__(self, items: Iterable[Item], num: int) -> None:
        self._items = items
        self._made: queue.Queue[tuple[bool, Any]] = queue.Queue(num)
        self._stopped = threading.Event()
        self.thread = threading.Thread(target=self._work, name="ahead", daemon=True)

    def made(self) -> Iterator[Item]:
        """The items, until there are no more."""
        while True:
            is_item, value = self._made.get()
            if is_item:
                yield value
            elif value is None:
                return
            else:
                raise value

    def stop(self) -> None:
        """Let the thread end, and wait until it has."""
        self._stopped.set()
        self.thread.join()

    def _work(self) -> None:
        end: BaseException | None = None
        try:
            for item in self._items:
                if not self._put((True, item)):
                    break
        except BaseException as error:
            end = error
        finally:
            close = getattr(self._items, "close", None)
            if close is not None:  # a generator gives back what it holds: here, not when the collector comes by
                close()
        self._put((False, end))

    def _put(self, entry: tuple[bool, Any]) -> bool:
        """False if nobody will take it."""
        while not self._stopped.is_set():
            try:
                self._made.put(entry, timeout=_POLL_S)
            except queue.Full:
                continue
            return True
        return False
