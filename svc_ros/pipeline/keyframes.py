"""Scans that later scans are judged against, kept with what was computed of them."""

from __future__ import annotations

import dataclasses
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from svc_ros.core.config import Config
from svc_ros.core.matches.descriptors import forget_trees, shared_descriptions
from svc_ros.core.registration import extract_features
from svc_ros.core.scan import Array, Features, PreparedScan
from svc_ros.core.search.prescore import thinned_scan
from svc_ros.pipeline.place import PlaceLook, look_at_place


class Keyframe:
    """A prepared scan where it stood; descriptors are computed on first use and kept.

    T_odom_scan: (4, 4), None where no odometry is known. Descriptors and look may be asked for by several threads; what
    registers or verifies keeps search structures with the scan: a thread beside others does that with a `lent` one.
    """

    def __init__(self, scan: PreparedScan, T_odom_scan: Array | None, config: Config) -> None:
        self.scan, self.T_odom_scan = scan, T_odom_scan
        self._config = config
        self._features: Features | None = None
        self._look: PlaceLook | None = None
        self._lock = threading.Lock()

    @property
    def features(self) -> Features:
        """What a global registration needs."""
        with self._lock:
            if self._features is None:
                self._features = extract_features(self.scan, self._config)
            return self._features

    @property
    def look(self) -> PlaceLook:
        """What is compared to find places that look the same."""
        with self._lock:
            if self._look is None:
                self._look = look_at_place(self.scan)
            return self._look

    def thinned(self, num_points: int) -> PreparedScan:
        """The scan with about that many points; itself where thinning it would leave fewer."""
        return self.scan if len(self.scan) < 2 * num_points else thinned_scan(self.scan, num_points)

    def forget_searches(self) -> None:
        """Give back the memory of search structures, some times that of the scan; they are built again when needed."""
        forget_trees(self.scan)

    @contextmanager
    def lent(self) -> Iterator[Keyframe]:
        """The same keyframe for one thread, with search structures of its own, which are forgotten in the end.

        What takes long is computed once for all: descriptors, the look, descriptions of more descriptors.
        """
        with self._lock:
            memo = shared_descriptions(self.scan)
        lent = _LentKeyframe(self, dataclasses.replace(self.scan, memo=memo), self.T_odom_scan, self._config)
        try:
            yield lent
        finally:
            lent.forget_searches()
            with self._lock:
                self.scan.memo.update(lent.scan.memo)


class _LentKeyframe(Keyframe):
    def __init__(self, owner: Keyframe, scan: PreparedScan, T_odom_scan: Array | None, config: Config) -> None:
        super().__init__(scan, T_odom_scan, config)
        self._owner = owner

    @property
    def features(self) -> Features:
        if self._features is None:
            self._features = Features(self.scan, self._owner.features.descriptors)
        return self._features

    @property
    def look(self) -> PlaceLook:
        return self._owner.look


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
