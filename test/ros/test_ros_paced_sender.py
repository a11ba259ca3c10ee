"""The sender of decisions without a middleware: who is waited for, for how long, and what is counted."""

from __future__ import annotations

import threading
import time

import pytest
from yardstick import PATIENCE_S, Stopwatch

from svc_ros.ros.topics import paced_sender
from svc_ros.ros.topics.paced_sender import PacedSender


@pytest.fixture(autouse=True)
def _not_so_patient(monkeypatch):
    monkeypatch.setattr(paced_sender, "PATIENCE_S", 1.0)


class Clock:
    """Time that passes only while somebody sleeps; in place of the module `time`."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch) -> Clock:
    """The sender's time, however busy the machine is."""
    clock = Clock()
    monkeypatch.setattr(paced_sender, "time", clock)
    return clock


class Reader:
    """Takes messages; each has arrived `delay_s` after it was sent, and none while it is stopped."""

    def __init__(self, delay_s: float = 0.0, clock=time) -> None:
        self.delay_s, self.is_stopped, self.clock = delay_s, False, clock
        self.sent: list[int] = []
        self.times: list[float] = []
        self.replaced = 0

    def send(self, message: int) -> None:
        self.replaced += not self.has_arrived()
        self.sent.append(message)
        self.times.append(self.clock.monotonic())

    def has_arrived(self) -> bool:
        return not self.times or (not self.is_stopped and self.clock.monotonic() - self.times[-1] >= self.delay_s)


def sender_to(reader: Reader) -> PacedSender[int]:
    return PacedSender(reader.send, reader.has_arrived)


def wait_for(condition, timeout_s=PATIENCE_S):
    end = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    return condition()


def test_a_slow_reader_gets_every_message_in_order(clock):
    reader = Reader(0.03, clock)
    sender = sender_to(reader)
    for k in range(20):
        sender.put(k)
    assert wait_for(lambda: len(reader.sent) == 20)
    assert sender.close(PATIENCE_S)
    assert reader.sent == list(range(20))
    assert (reader.replaced, sender.num_unacknowledged, sender.is_reader_stopped) == (0, 0, False)


def test_who_puts_never_waits():
    reader = Reader()
    reader.is_stopped = True
    sender = sender_to(reader)
    with Stopwatch() as watch:
        for k in range(50):
            sender.put(k)
    assert watch.own_s < 0.5, watch
    assert sender.num_waiting > 0
    sender.close(0.1)


def test_a_stopped_reader_is_waited_for_once_and_then_the_pace_is_kept(clock):
    reader = Reader(clock=clock)
    sender = sender_to(reader)
    sender.put(0)
    assert wait_for(lambda: reader.sent == [0])
    reader.is_stopped = True
    for k in range(1, 31):
        sender.put(k)
    assert wait_for(lambda: len(reader.sent) == 31)
    first, *others = [b - a for a, b in zip(reader.times, reader.times[1:], strict=False)]
    assert first >= paced_sender.PATIENCE_S
    assert min(others) >= 0.9 * paced_sender.PACE_S
    assert sum(others) < paced_sender.PATIENCE_S
    assert sender.is_reader_stopped
    assert sender.num_unacknowledged == reader.replaced == 30
    sender.close(0.1)


def test_messages_that_come_seldom_are_not_late_for_a_stopped_reader(clock):
    reader = Reader(clock=clock)
    sender = sender_to(reader)
    reader.is_stopped = True
    sender.put(0)
    sender.put(1)
    assert wait_for(lambda: sender.is_reader_stopped)
    assert wait_for(lambda: len(reader.sent) == 2)
    clock.sleep(0.05)
    start = clock.monotonic()
    sender.put(2)
    assert wait_for(lambda: len(reader.sent) == 3)
    assert reader.times[-1] - start < paced_sender.PACE_S
    sender.close(0.1)


def test_a_reader_that_goes_on_is_seen_even_if_nothing_is_sent():
    reader = Reader()
    reader.is_stopped = True
    sender = sender_to(reader)
    sender.put(0)
    sender.put(1)
    assert wait_for(lambda: sender.is_reader_stopped)
    reader.is_stopped = False
    assert wait_for(lambda: not sender.is_reader_stopped)
    assert sender.num_unacknowledged == 1
    sender.close(1.0)


def test_what_waits_is_bounded_by_going_faster(monkeypatch, clock):
    monkeypatch.setattr(paced_sender, "MANY", 20)
    reader = Reader(0.5, clock)
    sender = sender_to(reader)
    for k in range(60):
        sender.put(k)
    assert wait_for(lambda: sender.num_waiting <= 20)
    assert reader.times[39] - reader.times[0] < 2.0
    assert not sender.is_reader_stopped  # slow, not stopped
    assert sender.num_unacknowledged >= 30
    sender.close(0.1)


@pytest.mark.parametrize("is_stopped", [False, True])
def test_closing_sends_what_waits_in_time(is_stopped):
    reader = Reader(delay_s=0.2)
    reader.is_stopped = is_stopped
    sender = sender_to(reader)
    for k in range(40):
        sender.put(k)
    with Stopwatch() as watch:
        assert sender.close(0.3)
    assert watch.own_s < 0.8, watch
    assert reader.sent == list(range(40))


def test_an_exception_is_logged_and_the_next_message_is_sent(caplog):
    sent, done = [], threading.Event()

    def send(message):
        if message == 1:
            raise RuntimeError("no route")
        sent.append(message)
        if message == 2:
            done.set()

    def has_arrived():
        if not sent:
            return True
        raise RuntimeError("cannot be asked")

    sender = PacedSender(send, has_arrived)
    for k in range(3):
        sender.put(k)
    assert done.wait(PATIENCE_S)
    assert sender.close(1.0)
    assert sent == [0, 2]
    assert "no route" in caplog.text
    assert "cannot be asked" in caplog.text
