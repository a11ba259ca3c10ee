"""The way after the loops: when it is computed, and what is sent, without a middleware."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from yardstick import PATIENCE_S

from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.se3 import make_pose
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.trajectories import Trajectory
from svc_ros.ros.topics import optimised_path
from svc_ros.ros.topics.optimised_path import OptimisedPath

pytestmark = pytest.mark.dds

POSES = np.array([make_pose(np.eye(3), (float(k), 0.0, 0.0)) for k in range(3)])
KEYFRAMES = Trajectory(np.array([1, 2, 3]) * 1_000_000_000, POSES)
EDGE = GraphEdge(2, 0, make_pose(np.eye(3), (2.0, 1.0, 0.0)), 1e-4 * np.eye(6))
STEPS = [GraphEdge(k, k - 1, make_pose(np.eye(3), (1.0, 0.0, 0.0)), np.eye(6)) for k in (1, 2)]


class StandInNode:
    def __init__(self, num_subscribers: int = 1) -> None:
        self.sent, self.warnings, self.num_subscribers = [], [], num_subscribers

    def create_publisher(self, _kind, _topic, _qos):
        return SimpleNamespace(publish=self.sent.append, get_subscription_count=lambda: self.num_subscribers)

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


def path_of(node: StandInNode, found) -> OptimisedPath:
    return OptimisedPath(node, lambda: found[0], lambda: "odom")


def tell(path: OptimisedPath) -> None:
    path.tell()
    if path._thread is not None:
        path._thread.join(PATIENCE_S)


def test_a_change_is_sent_once_and_the_next_one_again():
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    node, found = StandInNode(), [(1, KEYFRAMES, PoseGraph(POSES, [*STEPS, EDGE]))]
    path = path_of(node, found)
    tell(path)
    tell(path)
    (message,) = node.sent
    assert message.header.frame_id == "odom"
    assert [pose.header.stamp.sec for pose in message.poses] == [1, 2, 3]
    assert message.poses[0].pose.position.x == pytest.approx(0.0)
    assert message.poses[2].pose.position.y == pytest.approx(1.0, abs=0.01)
    found[0] = (2, KEYFRAMES, PoseGraph(POSES, STEPS))
    tell(path)
    assert node.sent[1].poses[2].pose.position.y == pytest.approx(0.0, abs=1e-6)


def test_after_a_reset_an_empty_path_takes_the_place_of_the_last_one():
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    node, found = StandInNode(), [(1, KEYFRAMES, PoseGraph(POSES, [*STEPS, EDGE]))]
    path = path_of(node, found)
    tell(path)
    found[0] = None
    tell(path)
    tell(path)
    assert [len(message.poses) for message in node.sent] == [3, 0]
    assert node.sent[1].header.frame_id == "odom"
    found[0] = (2, KEYFRAMES, PoseGraph(POSES, STEPS))
    tell(path)
    assert len(node.sent[2].poses) == 3


def test_nothing_is_computed_without_loops_keyframes_or_subscribers(monkeypatch):
    monkeypatch.setattr(optimised_path, "optimise_poses", pytest.fail)
    graph = PoseGraph(POSES, STEPS)
    tell(path_of(StandInNode(), [None]))
    tell(path_of(StandInNode(), [(0, KEYFRAMES, graph)]))
    tell(path_of(StandInNode(0), [(1, KEYFRAMES, graph)]))


def test_without_gtsam_it_is_said_once(monkeypatch):
    def missing(_graph):
        raise MissingDependencyError("needs gtsam")

    monkeypatch.setattr(optimised_path, "optimise_poses", missing)
    node, found = StandInNode(), [(1, KEYFRAMES, PoseGraph(POSES, STEPS))]
    path = path_of(node, found)
    tell(path)
    found[0] = (2, *found[0][1:])
    tell(path)
    assert node.warnings == ["optimized_path: needs gtsam"]
    assert node.sent == []
