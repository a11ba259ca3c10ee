"""A reference trajectory beside a replay: how wrong is each pose, and how wrong is the whole trajectory?"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, MissingDependencyError, TransformUnavailableError
from svc_ros.core.scan import IndexArray
from svc_ros.core.se3 import Array, invert, make_pose, pose_error
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.io.transforms import TransformTree, normalise_frame
from svc_ros.pipeline.stream import StreamDecision

MAX_ROTATION_DEG, MAX_TRANSLATION_M = 5.0, 0.6  # an accepted pose beyond either is false
_STAMP_TOLERANCE_NS = 1_000_000  # text files round the stamps of their first and last pose
_STATISTICS = ("rmse", "mean", "median", "std", "min", "max")
_MIN_POSES = 3  # fewer can be laid on any others


@dataclass(frozen=True, eq=False)
class Reference:
    """Poses of `frame` over time (None: of the clouds' own frame), and the bag's transforms between the two frames.

    targets: the same of the targets, where those are not of this bag but of a map.
    """

    trajectory: Trajectory
    transforms: TransformTree
    frame: str | None
    targets: Trajectory | None = None

    @classmethod
    def read(cls, path: Path, bag: Bag, frame: str | None, targets: Path | None = None) -> Reference:
        """Read a TUM file, or two of them; raises InputError for a frame that the bag's transforms do not know."""
        transforms = bag.transforms()
        frame = None if frame is None else normalise_frame(frame)
        if frame is not None and frame not in transforms.frames:
            known = ", ".join(transforms.frames) or "none"
            raise InputError(f"--reference-frame {frame}: not among the frames of the bag ({known})")
        return cls(read_tum(path), transforms, frame, None if targets is None else read_tum(targets))

    def errors(self, decision: StreamDecision) -> tuple[float, float] | None:
        """Rotation [deg] and translation [m] error of the best candidate; None without one or without a reference."""
        if decision.result.best_candidate is None:
            return None
        T_world_source = self.pose(decision.source_stamp_ns, decision.source_frame)
        T_world_target = self._pose(self.targets or self.trajectory, decision.target_stamp_ns, decision.target_frame)
        if T_world_source is None or T_world_target is None:
            return None
        return pose_error(decision.result.best_candidate, invert(T_world_target) @ T_world_source)

    def of_clouds(self, cloud_frame: str) -> Trajectory:
        """The reference as poses of the clouds' frame, at its own stamps as far as the bag has the transform."""
        if self.frame is None or self.frame == normalise_frame(cloud_frame):
            return self.trajectory
        poses = {int(stamp): self.pose(int(stamp), cloud_frame) for stamp in self.trajectory.stamps_ns}
        known = {stamp: pose for stamp, pose in poses.items() if pose is not None}
        return Trajectory(np.array(list(known), np.int64), np.array(list(known.values())).reshape(-1, 4, 4))

    def pose(self, stamp_ns: int, cloud_frame: str) -> Array | None:
        """Where a cloud stood (4, 4); None outside the reference's time, or without a transform between the frames."""
        return self._pose(self.trajectory, stamp_ns, cloud_frame)

    def _pose(self, trajectory: Trajectory, stamp_ns: int, cloud_frame: str) -> Array | None:
        try:
            T_world_reference = trajectory.at(stamp_ns, _STAMP_TOLERANCE_NS)
            if self.frame is None or self.frame == normalise_frame(cloud_frame):
                return T_world_reference
            return T_world_reference @ self.transforms.lookup(self.frame, cloud_frame, stamp_ns)
        except TransformUnavailableError:
            return None  # the summary counts these


def check_evo() -> None:
    """Raise MissingDependencyError where evo is not installed."""
    try:
        import evo.core.metrics  # noqa: F401
    except ImportError:
        raise MissingDependencyError("comparing with a reference needs evo: pip install 'evo>=1.30'") from None


def trajectory_errors(stamps_ns: IndexArray, estimated: Array, reference: Array) -> dict[str, Any]:
    """Absolute and relative pose errors by evo; both None for fewer than three poses. Raises MissingDependencyError.

    stamps_ns (N,); estimated, reference: (N, 4, 4) [m], poses at those stamps. `ape` is taken after laying the
    estimated trajectory on the reference, without a change of scale: for `translation_m` so that its positions fit
    best, for `rotation_deg` by the mean of its turns, which a straight way tells too. `rpe` compares the motions
    between neighbouring poses. Each has rmse, mean, median, std, min, max.
    """
    if len(estimated) < _MIN_POSES:
        return {"num_poses_compared": len(estimated), "ape": None, "rpe": None}
    check_evo()
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    seconds = np.asarray(stamps_ns, np.float64) * 1e-9

    def placed(poses: Array) -> Any:
        return PoseTrajectory3D(poses_se3=list(poses), timestamps=seconds)

    T_turned = _mean_turn(estimated, reference)
    truth, turned, fitted = placed(reference), placed(T_turned @ estimated), placed(T_turned @ estimated)
    _fit_positions(fitted, truth)
    shift, turn = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg
    return {
        "num_poses_compared": len(estimated),
        "ape": {
            "translation_m": _statistics(metrics.APE(shift), truth, fitted),
            "rotation_deg": _statistics(metrics.APE(turn), truth, turned),
        },
        "rpe": {
            "translation_m": _statistics(metrics.RPE(shift), truth, fitted),
            "rotation_deg": _statistics(metrics.RPE(turn), truth, turned),
        },
    }


def _mean_turn(estimated: Array, reference: Array) -> Array:
    """(4, 4) that turns the estimated poses by the mean of what is missing, and lays centre on centre."""
    missing = Rotation.from_matrix(reference[:, :3, :3] @ estimated[:, :3, :3].transpose(0, 2, 1)).mean().as_matrix()
    centres = reference[:, :3, 3].mean(axis=0), estimated[:, :3, 3].mean(axis=0)
    return make_pose(missing, centres[0] - missing @ centres[1])


def _fit_positions(moved: Any, truth: Any) -> None:
    from evo.core.geometry import GeometryException

    # Positions on one line leave a turn about it open: they stay as the mean of the turns has laid them.
    with contextlib.suppress(GeometryException):
        moved.align(truth)


def _statistics(metric: Any, truth: Any, moved: Any) -> dict[str, float]:
    metric.process_data((truth, moved))
    found = metric.get_all_statistics()
    return {name: float(found[name]) for name in _STATISTICS}
