"""A reference trajectory beside a replay: how wrong is each pose?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.se3 import Array, invert, pose_error
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.io.transforms import TransformTree, normalise_frame
from svc_ros.pipeline.replay import ReplayedPair

_STAMP_TOLERANCE_NS = 1_000_000  # text files round the stamps of their first and last pose


@dataclass(frozen=True, eq=False)
class Reference:
    """Poses of `frame` over time (None: of the clouds' own frame), and the bag's transforms between the two frames."""

    trajectory: Trajectory
    transforms: TransformTree
    frame: str | None

    @classmethod
    def read(cls, path: Path, bag: Bag, frame: str | None) -> Reference:
        """Read a TUM file; raises InputError for a frame that the bag's transforms do not know."""
        transforms = bag.transforms()
        frame = None if frame is None else normalise_frame(frame)
        if frame is not None and frame not in transforms.frames:
            known = ", ".join(transforms.frames) or "none"
            raise InputError(f"--reference-frame {frame}: not among the frames of the bag ({known})")
        return cls(read_tum(path), transforms, frame)

    def errors(self, pair: ReplayedPair) -> tuple[float, float] | None:
        """Rotation [deg] and translation [m] error of the best candidate; None without one or without a reference."""
        if pair.result.best_candidate is None:
            return None
        try:
            T_world_source = self._pose(pair.source_stamp_ns, pair.source_frame)
            T_world_target = self._pose(pair.target_stamp_ns, pair.target_frame)
        except TransformUnavailableError:
            return None  # the summary counts these
        return pose_error(pair.result.best_candidate, invert(T_world_target) @ T_world_source)

    def _pose(self, stamp_ns: int, cloud_frame: str) -> Array:
        T_world_reference = self.trajectory.at(stamp_ns, _STAMP_TOLERANCE_NS)
        if self.frame is None or self.frame == normalise_frame(cloud_frame):
            return T_world_reference
        pose: Array = T_world_reference @ self.transforms.lookup(self.frame, cloud_frame, stamp_ns)
        return pose
