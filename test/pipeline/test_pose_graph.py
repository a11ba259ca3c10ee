"""Keyframes and loops become a graph: its edges hold what was measured, and only what was accepted."""

from __future__ import annotations

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.config import CovarianceConfig
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StreamDecision

FLOOR = CovarianceConfig()
POSES = np.array([se3.make_pose(np.eye(3), (2.0 * k, 0.0, 0.0)) for k in range(4)])
KEYFRAMES = Trajectory(np.array([10, 20, 30, 40]), POSES)
LOOP = se3.make_pose(np.eye(3), (5.5, 0.1, 0.0))


def decision(source: int, target: int, verdict: Verdict = Verdict.ACCEPTED) -> StreamDecision:
    accepted = verdict is Verdict.ACCEPTED
    result = RegistrationResult(
        verdict, Reason.OK if accepted else Reason.LOW_OVERLAP, "svc", LOOP if accepted else None, LOOP,
        2.0 * np.eye(6) if accepted else None,
    )  # fmt: skip
    return StreamDecision(result, source, target, "lidar", "lidar")


def test_keyframes_follow_each_other_by_odometry() -> None:
    graph = build_pose_graph(KEYFRAMES, [], FLOOR)
    assert [(e.target, e.source) for e in graph.edges] == [(0, 1), (1, 2), (2, 3)]
    for edge in graph.edges:
        np.testing.assert_allclose(edge.T_target_source[:3, 3], (2.0, 0.0, 0.0))
        assert edge.covariance[0, 0] > FLOOR.floor_translation_m**2


def test_longer_steps_are_less_certain() -> None:
    far = Trajectory(np.array([1, 2, 3]), POSES[[0, 1, 3]])
    near_edge, far_edge = build_pose_graph(far, [], FLOOR).edges
    assert far_edge.covariance[0, 0] > near_edge.covariance[0, 0]


def test_accepted_loops_are_edges_and_no_others() -> None:
    decisions = [decision(40, 10), decision(40, 20, Verdict.REJECTED), decision(40, 20, Verdict.UNDECIDED)]
    loops = build_pose_graph(KEYFRAMES, decisions, FLOOR).edges[3:]
    assert [(e.target, e.source) for e in loops] == [(0, 3)]
    np.testing.assert_array_equal(loops[0].T_target_source, LOOP)
    np.testing.assert_array_equal(loops[0].covariance, 2.0 * np.eye(6))


def test_a_loop_of_an_unknown_scan_is_refused() -> None:
    with pytest.raises(InputError, match="41 ns has a loop but is no keyframe"):
        build_pose_graph(KEYFRAMES, [decision(41, 10)], FLOOR)


def test_no_keyframes_are_an_empty_graph() -> None:
    graph = build_pose_graph(Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4))), [], FLOOR)
    assert (len(graph.poses), len(graph.edges)) == (0, 0)
