"""A map of keyframes in memory, with what localisation asks of one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Array, IndexArray, Scan
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.place import PlaceLook, compare_places


class MapInMemory:
    """Scans where they stood: poses (N, 4, 4), T_map_scan."""

    def __init__(self, scans: Sequence[Scan], poses: Sequence[Array], config: Config) -> None:
        self.config, self.poses = config, np.array(poses).reshape(-1, 4, 4)
        self.keyframes = [Keyframe(prepare(scan, config), T, config) for scan, T in zip(scans, poses, strict=True)]

    @property
    def stamps_ns(self) -> IndexArray:
        return np.array([keyframe.scan.stamp_ns for keyframe in self.keyframes], np.int64)

    def __len__(self) -> int:
        return len(self.keyframes)

    def keyframe(self, index: int) -> Keyframe:
        return self.keyframes[index]

    def near(self, T_map_scan: Array, radius_m: float, most: int) -> list[int]:
        distance = np.linalg.norm(self.poses[:, :3, 3] - T_map_scan[:3, 3], axis=1)
        return [int(k) for k in np.argsort(distance, kind="stable") if distance[k] <= radius_m][:most]

    def similar(self, look: PlaceLook, most: int) -> list[tuple[int, float]]:
        found = [(k, compare_places(look, keyframe.look)[0]) for k, keyframe in enumerate(self.keyframes)]
        return sorted(found, key=lambda pair: -pair[1])[:most]
