"""The way of a loop closure after its loops: where every scan stood by odometry and loops together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from svc_ros.core.errors import MissingDependencyError
from svc_ros.evaluation.bag_reference import Reference
from svc_ros.io.g2o import PoseGraph
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.pipeline.graph_optimisation import correct_trajectory, optimise_poses
from svc_ros.replay.summary import trajectory_numbers


@dataclass(frozen=True, eq=False)
class OptimisedWay:
    """trajectory: None where it cannot be computed, as `note` says then."""

    trajectory: Trajectory | None
    note: str = ""

    def write(self, path: Path) -> None:
        """As a TUM file, where there is one."""
        if self.trajectory is not None:
            write_tum(path, self.trajectory)

    def numbers(self) -> dict[str, Any]:
        """For a summary."""
        return {"note": self.note} if self.trajectory is None else {"num_poses": len(self.trajectory)}

    def compared(self, reference: Reference, frame_id: str) -> dict[str, Any]:
        """Errors against the reference, in the key `optimized`; nothing where there is no trajectory."""
        if self.trajectory is None:
            return {}
        return {"optimized": trajectory_numbers(self.trajectory, reference, frame_id)}


def optimise_way(odometry: Trajectory, keyframes: Trajectory, graph: PoseGraph) -> OptimisedWay:
    """odometry: of all scans; graph: of the keyframes, with loops."""
    try:
        found = optimise_poses(graph)
    except MissingDependencyError as error:
        return OptimisedWay(None, str(error))
    return OptimisedWay(correct_trajectory(odometry, keyframes, found))
