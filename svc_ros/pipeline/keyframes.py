"""Scans that later scans are judged against, kept with what was computed of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from svc_ros.core.config import Config
from svc_ros.core.matches.descriptors import forget_trees
from svc_ros.core.registration import extract_features
from svc_ros.core.scan import Array, Features, PreparedScan
from svc_ros.pipeline.place import PlaceLook, look_at_place


class Keyframe:
    """A prepared scan where it stood; descriptors are computed on first use and kept.

    T_odom_scan: (4, 4), None where no odometry is known.
    """

    def __init__(self, scan: PreparedScan, T_odom_scan: Array | None, config: Config) -> None:
        self.scan, self.T_odom_scan = scan, T_odom_scan
        self._config = config
        self._features: Features | None = None
        self._look: PlaceLook | None = None

    @property
    def features(self) -> Features:
        """What a global registration needs."""
        if self._features is None:
            self._features = extract_features(self.scan, self._config)
        return self._features

    @property
    def look(self) -> PlaceLook:
        """What is compared to find places that look the same."""
        if self._look is None:
            self._look = look_at_place(self.scan)
        return self._look

    def forget_searches(self) -> None:
        """Give back the memory of search structures, some times that of the scan; they are built again when needed."""
        forget_trees(self.scan)


class KeyframeStore:
    """At most `capacity` keyframes, the newest; older ones leave first."""

    def __init__(self, capacity: int) -> None:
        self._keyframes: deque[Keyframe] = deque(maxlen=capacity)

    def add(self, keyframe: Keyframe) -> None:
        """Take the next keyframe."""
        self._keyframes.append(keyframe)

    def clear(self) -> None:
        """Forget all of them."""
        self._keyframes.clear()

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[Keyframe]:
        return iter(self._keyframes)

    def __reversed__(self) -> Iterator[Keyframe]:
        return reversed(self._keyframes)
