"""Bags that this package writes: simulated clouds and transforms as a ROS 2 bag folder.

Messages are stamped with the time of the scan that they are about, never with the time of writing.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import check_pose
from svc_ros.io.bags.mcap_folder import CLOUD_TYPE, McapFolder
from svc_ros.io.transforms import normalise_frame

_MAX_STAMP_NS = 2**31 * 1_000_000_000  # builtin_interfaces/Time counts seconds in 32 bits


class CloudBagWriter:
    """A ROS 2 bag folder (MCAP) of clouds and transforms. An existing folder is refused with InputError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f"{path}: exists already; bags are not overwritten")
        try:
            self._bag = McapFolder(self.path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
        self._bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
        self._statics: dict[str, Any] = {}
        self._is_open = True

    def write_points(self, stamp_ns: int, frame_id: str, points: ArrayLike, topic: str = "/points") -> None:
        """Write a cloud as float32 x y z intensity: points (N, 3) [m], or (N, 4) with the intensity (else zeros)."""
        values, stamp = np.asarray(points, np.float64), checked_stamp(stamp_ns)
        if values.ndim != 2 or values.shape[1] not in (3, 4):
            raise InputError(f"points: expected shape N x 3 or N x 4, found {values.shape}")
        intensity = values[:, 3] if values.shape[1] == 4 else np.zeros(len(values))
        if topic not in self._bag.connections:
            self._bag.add_topic(topic, CLOUD_TYPE)
        header = self._bag.header(stamp, frame_id)
        self._bag.write(topic, stamp, self._bag.cloud(header, values[:, :3], {"intensity": intensity}))

    def write_transform(self, stamp_ns: int, parent: str, child: str, T: ArrayLike, static: bool = False) -> None:
        """Write p_parent = T p_child, T (4, 4) [m], to /tf, or to /tf_static with all static ones before it.

        The last message on /tf_static is thus complete, which is all that a late subscriber gets.
        """
        pose, stamp = check_pose(T, f"transform {parent} -> {child}"), checked_stamp(stamp_ns)
        stamped = self._bag.transform(self._bag.header(stamp, normalise_frame(parent)), normalise_frame(child), pose)
        transforms = [stamped]
        if static:
            self._statics[normalise_frame(child)] = stamped
            transforms = list(self._statics.values())
        message = self._bag.make("tf2_msgs/msg/TFMessage", transforms=transforms)
        self._bag.write("/tf_static" if static else "/tf", stamp, message)

    def close(self) -> None:
        """Finish the bag; a second call does nothing."""
        if self._is_open:
            self._is_open = False
            self._bag.close()

    def __enter__(self) -> CloudBagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def distinct_frames(target_frame: str, source_frame: str) -> tuple[str, str]:
    """Names (parent, child) for a transform between two scans: never empty, never the same."""
    parent, child = target_frame.lstrip("/") or "target", source_frame.lstrip("/") or "source"
    return parent, f"{child}/source" if child == parent else child


def checked_stamp(stamp_ns: int) -> int:
    """The stamp itself, or InputError where a message cannot hold it."""
    if not 0 <= stamp_ns < _MAX_STAMP_NS:
        raise InputError(f"stamp: expected nanoseconds from 0 to {_MAX_STAMP_NS}, found {stamp_ns}")
    return int(stamp_ns)
