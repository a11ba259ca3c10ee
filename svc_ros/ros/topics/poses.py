"""Poses that arrive by message and are asked for by stamp: guesses and odometry. No rclpy here."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left
from collections.abc import Callable

import numpy as np

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.io.stamps import text_from_ns
from svc_ros.io.trajectories import Trajectory


class PoseBuffer:
    """The newest poses (4, 4) by stamp, at most `capacity`; safe for use from several threads.

    A stamp before the last one by more than `max_back_ns` is a jump back in time: what was before is forgotten.
    """

    def __init__(self, capacity: int, max_back_ns: int = 1_000_000_000) -> None:
        self._capacity, self._max_back_ns = capacity, max_back_ns
        self._stamps: list[int] = []
        self._poses: list[Array] = []
        self._changed = threading.Condition()
        self.num_received = 0

    def add(self, stamp_ns: int, pose: Array) -> None:
        """Keep a pose; of two with one stamp the later one."""
        with self._changed:
            self.num_received += 1
            if self._stamps and stamp_ns < self._stamps[-1] - self._max_back_ns:
                self._clear()
            place = bisect_left(self._stamps, stamp_ns)
            same = place < len(self._stamps) and self._stamps[place] == stamp_ns
            self._stamps[place : place + same] = [stamp_ns]
            self._poses[place : place + same] = [pose]
            del self._stamps[: -self._capacity], self._poses[: -self._capacity]
            self._changed.notify_all()

    def clear(self) -> None:
        """Forget all poses."""
        with self._changed:
            self._clear()

    def nearest(self, stamp_ns: int, max_skew_ns: int) -> Array | None:
        """The pose nearest in time, if it is near enough."""
        with self._changed:
            skews = [abs(stamp - stamp_ns) for stamp in self._stamps]
            best = int(np.argmin(skews)) if skews else -1
            return self._poses[best] if skews and skews[best] <= max_skew_ns else None

    def at(self, stamp_ns: int, max_skew_ns: int, timeout_s: float) -> Array:
        """The pose (4, 4) at a stamp, interpolated, waiting up to `timeout_s` for the one behind it.

        Up to `max_skew_ns` outside the span the first or last one. TransformUnavailableError names stamp and span.
        """
        with self._changed:
            self._wait(lambda: bool(self._stamps) and self._stamps[-1] >= stamp_ns, timeout_s)
            stamps, poses = list(self._stamps), list(self._poses)
        try:
            return Trajectory(np.array(stamps, np.int64), np.array(poses).reshape(-1, 4, 4)).at(stamp_ns, max_skew_ns)
        except TransformUnavailableError:
            span = f"{text_from_ns(stamps[0])} s to {text_from_ns(stamps[-1])} s" if stamps else "none so far"
            raise TransformUnavailableError(f"expected odometry at {text_from_ns(stamp_ns)} s, found {span}") from None

    def _wait(self, condition: Callable[[], bool], timeout_s: float) -> None:
        end = time.monotonic() + timeout_s
        while not condition() and (left := end - time.monotonic()) > 0.0:
            self._changed.wait(left)

    def _clear(self) -> None:
        self._stamps.clear()
        self._poses.clear()
