"""Keyframes and loops as a pose graph for a back end."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from svc_ros.core import se3
from svc_ros.core.decision_config import CovarianceConfig
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.stream import StreamDecision

_DRIFT = 0.02  # odometry's error grows by so much for each metre, and for each radian


def build_pose_graph(keyframes: Trajectory, decisions: Iterable[StreamDecision], floor: CovarianceConfig) -> PoseGraph:
    """One vertex a keyframe, one edge from each to the next by odometry, one edge for each accepted loop.

    keyframes: their poses in the odometry frame; decisions: loops between them, of which those that were not accepted
    are left out; floor: of the odometry's error. Raises InputError for an accepted loop between scans that are no
    keyframes.
    """
    number = {int(stamp): i for i, stamp in enumerate(keyframes.stamps_ns)}
    edges = [_odometry_edge(keyframes.poses, i, floor) for i in range(1, len(keyframes))]
    for decision in decisions:
        result = decision.result
        if result.T_target_source is None or result.covariance is None:
            continue
        for stamp in (decision.source_stamp_ns, decision.target_stamp_ns):
            if stamp not in number:
                raise InputError(f"pose graph: the scan at {stamp} ns has a loop but is no keyframe")
        source, target = number[decision.source_stamp_ns], number[decision.target_stamp_ns]
        edges.append(GraphEdge(source, target, result.T_target_source, result.covariance))
    return PoseGraph(keyframes.poses, edges)


def _odometry_edge(poses: Array, source: int, floor: CovarianceConfig) -> GraphEdge:
    T = se3.invert(poses[source - 1]) @ poses[source]
    angle, distance = se3.pose_error(T, np.eye(4))
    shift = floor.floor_translation_m + _DRIFT * distance
    turn = np.radians(floor.floor_rotation_deg + _DRIFT * angle)
    return GraphEdge(source, source - 1, T, np.diag([shift**2] * 3 + [turn**2] * 3))
