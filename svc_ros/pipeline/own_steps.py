"""Where each scan stands in the odometry frame, also where odometry says nothing."""

from __future__ import annotations

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.scan import Array
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.loop_closure import judge_candidate


class OwnSteps:
    """Goes on from the last scan by registration where a scan has no odometry; not for several threads at once."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self.clear()

    def clear(self) -> None:
        """Forget the last scan."""
        self._last: tuple[Keyframe, Array] | None = None
        self._step = np.eye(4)
        self._is_own_frame = False  # it began where nobody knew how the scan was joined to the last one

    def follow(self, this: Keyframe, T_odom_scan: Array | None) -> tuple[Array, bool]:
        """The pose (4, 4) of the next scan, and False where it is not joined to those before: a frame of its own."""
        last, joined = self._last, True
        if T_odom_scan is not None:
            joined, self._is_own_frame = not self._is_own_frame, False
        elif last is None:
            T_odom_scan, self._is_own_frame = np.eye(4), True
        else:
            T_last_this = self._register(this, last[0])
            if T_last_this is None:
                T_odom_scan, joined, self._is_own_frame = np.eye(4), False, True
            else:
                T_odom_scan, self._step = last[1] @ T_last_this, T_last_this
        self._last = this, T_odom_scan
        return T_odom_scan, joined

    def _register(self, this: Keyframe, last: Keyframe) -> Array | None:
        """The motion between two scans, if it is sure: the last one's is tried first."""
        return judge_candidate(this, last, self._step, self._config).T_target_source
