"""Messages to readers that acknowledge them, one after the other: slow readers are waited for, stopped ones are not.

No rclpy here. A middleware that keeps only the last message replaces one that a reader has not taken yet. So the next
message waits until all readers have the one before, on a thread of its own: neither who puts messages nor anyone else
in the process waits with it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_log = logging.getLogger(__name__)
Message = TypeVar("Message")

PATIENCE_S = 2.0  # a reader that has not acknowledged a message after so long is taken for stopped
PACE_S = 0.02  # between messages while a reader is stopped: the others get each of them in that time
MANY = 1000  # so many may wait for slow readers; more are sent at the pace, too
_OUT_IN_S = 2.0  # at the pace, everything that waits is sent in that time; it is quicker then
_ASK_EVERY_S, _LOOK_EVERY_S = 0.001, 0.5


class PacedSender(Generic[Message]):
    """Sends in the order of `put`, each message when all readers have acknowledged the one before.

    A reader that takes longer than `PATIENCE_S` for one message is not waited for until it has caught up. Messages that
    were replaced before all readers had them are counted as unacknowledged.

    send: what sends one message; has_arrived: True if all readers have acknowledged everything that was sent, asked
    again and again, so it must not block. What either of them raises is logged, and the next message is sent.
    """

    def __init__(self, send: Callable[[Message], None], has_arrived: Callable[[], bool]) -> None:
        self._send, self._has_arrived = send, has_arrived
        self._messages: deque[Message] = deque()
        self._changed = threading.Condition()
        self._close_by_s: float | None = None
        self._sent_s = -PATIENCE_S
        self.is_reader_stopped, self.num_unacknowledged = False, 0
        self._thread = threading.Thread(target=self._run, name="decisions", daemon=True)
        self._thread.start()

    @property
    def num_waiting(self) -> int:
        """Messages that are not sent yet."""
        return len(self._messages)

    def put(self, message: Message) -> None:
        """Send this message when it is its turn; does not wait."""
        with self._changed:
            self._messages.append(message)
            self._changed.notify()

    def close(self, timeout_s: float) -> bool:
        """Send what waits, in that time however slow the readers are; False if sending itself took longer."""
        with self._changed:
            self._close_by_s = time.monotonic() + timeout_s
            self._changed.notify()
        self._thread.join(timeout_s + PATIENCE_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while self._wait_for_work():
            self._wait_for_readers()
            try:
                self._send(self._messages[0])
            except Exception:
                _log.exception("a message could not be sent")
            self._sent_s = time.monotonic()
            self._messages.popleft()
        self._wait_for_the_last()

    def _wait_for_work(self) -> bool:
        """False when everything is sent and nothing more will come."""
        with self._changed:
            while not self._messages and self._close_by_s is None:
                self._changed.wait(_LOOK_EVERY_S if self.is_reader_stopped else None)
                self.is_reader_stopped = self.is_reader_stopped and not self._have_all_arrived()
            return bool(self._messages)

    def _wait_for_readers(self) -> None:
        while not self._have_all_arrived():
            waited_s = time.monotonic() - self._sent_s
            if waited_s >= self._patience_s():
                self.is_reader_stopped = self.is_reader_stopped or waited_s >= PATIENCE_S
                self.num_unacknowledged += 1
                return
            time.sleep(_ASK_EVERY_S)
        self.is_reader_stopped = False

    def _wait_for_the_last(self) -> None:
        """Who closes gives the publisher back, and with it what has not arrived."""
        end_s = self._close_by_s or 0.0
        while not self.is_reader_stopped and time.monotonic() < end_s and not self._have_all_arrived():
            time.sleep(_ASK_EVERY_S)

    def _have_all_arrived(self) -> bool:
        try:
            return self._has_arrived()
        except Exception:
            _log.exception("readers could not be asked")
            return True

    def _patience_s(self) -> float:
        """How long readers have for the message that was sent last."""
        waiting = len(self._messages)
        in_haste = self.is_reader_stopped or waiting > MANY
        patience = min(PACE_S, _OUT_IN_S / waiting) if in_haste else PATIENCE_S
        if self._close_by_s is None:
            return patience
        return min(patience, max(self._close_by_s - time.monotonic(), 0.0) / waiting)
