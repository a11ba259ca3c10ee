"""Messages that did not come, as a share of those that were sent. No rclpy here."""

from __future__ import annotations

import threading
from collections import deque

_WINDOW_S = 3.0
_WORTH_A_WARNING = 0.05
_REMEMBERED_S = 10.0  # a warning stays for this long: with a cloud every few seconds it would flicker


class LossMonitor:
    """One topic's losses; times are of a steady clock [s]. Safe for use from several threads.

    A loss is seen in two ways, and the larger number counts: the middleware reports it, which it does not where its own
    queue was full; and the numbers of the messages have a gap, which says nothing as long as several publishers count.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last_number: int | None = None
        self._in_gaps, self._reported, self._num_lost = 0, 0, 0
        self._events: deque[tuple[float, int, int]] = deque()  # time, messages that came, messages lost
        self._warning = ""
        self._warned_s = float("-inf")

    @property
    def num_lost(self) -> int:
        """Messages lost since the start."""
        with self._lock:
            return self._num_lost

    def take(self, number: int | None, now_s: float) -> None:
        """A message came. number: as its publisher counts, None where several publish or nobody counts."""
        with self._lock:
            if number is not None and self._last_number is not None and number > self._last_number:
                self._in_gaps += number - self._last_number - 1  # a smaller one is a publisher's that began anew
            if number is None and self._last_number is not None:
                self._in_gaps = self._reported = max(self._in_gaps, self._reported)  # from now on reports alone count
            self._last_number = number
            self._note(now_s, 1)

    def report(self, num_more: int, now_s: float) -> None:
        """The middleware says how many it has lost since its last report."""
        with self._lock:
            self._reported += num_more
            self._note(now_s, 0)

    def share(self, now_s: float) -> tuple[int, int]:
        """Messages lost, and messages sent, in the last three seconds."""
        with self._lock:
            return self._share(now_s)

    def warning(self, now_s: float) -> str:
        """What was lost, while more than 5 % of the last three seconds' messages are, and for some time after."""
        with self._lock:
            lost, sent = self._share(now_s)
            if lost > _WORTH_A_WARNING * sent:
                self._warning = f"{lost} of {sent} lost in {_WINDOW_S:g} s ({100 * lost / sent:.0f} %)"
                self._warned_s = now_s
            return self._warning if now_s - self._warned_s <= _REMEMBERED_S else ""

    def _share(self, now_s: float) -> tuple[int, int]:
        while self._events and self._events[0][0] <= now_s - _WINDOW_S:
            self._events.popleft()
        lost = sum(lost for _, _, lost in self._events)
        return lost, lost + sum(came for _, came, _ in self._events)

    def _note(self, now_s: float, num_came: int) -> None:
        lost = max(self._in_gaps, self._reported) - self._num_lost
        self._num_lost += lost
        self._events.append((now_s, num_came, lost))
