"""Poses in a map that others tell by message, each to be judged once. No rclpy here."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from svc_ros.core.scan import Array

_KEPT = 16
_MAX_BACK_NS = 1_000_000_000  # what is farther back is of a new time


@dataclass(frozen=True, eq=False)
class StampedPose:
    """T_frame_base (4, 4) in a named frame; stamp_ns: 0 for now."""

    stamp_ns: int
    frame_id: str
    T_frame_base: Array


class ToldPoses:
    """The newest told poses that nobody has asked for yet; safe for use from several threads."""

    def __init__(self) -> None:
        self._poses: deque[StampedPose] = deque(maxlen=_KEPT)
        self._lock = threading.Lock()

    def add(self, pose: StampedPose) -> None:
        """Keep a pose."""
        with self._lock:
            if self._poses and 0 < pose.stamp_ns < self._poses[-1].stamp_ns - _MAX_BACK_NS:
                self._poses.clear()
            self._poses.append(pose)

    def take(self, stamp_ns: int) -> StampedPose | None:
        """The last one that came of those up to a stamp; it and those before it are forgotten."""
        with self._lock:
            due = [pose for pose in self._poses if pose.stamp_ns <= stamp_ns]
            self._poses = deque((pose for pose in self._poses if pose.stamp_ns > stamp_ns), maxlen=_KEPT)
            return due[-1] if due else None

    def clear(self) -> None:
        """Forget all of them."""
        with self._lock:
            self._poses.clear()
