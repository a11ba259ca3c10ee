"""What a person looks at is made only while somebody looks, and is capped."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

import dataclasses

import numpy as np
from mini_data import POSES, pose_between, scan_room

from svc_ros.core.config import preset
from svc_ros.core.registration import prepare, verify
from svc_ros.core.scan import Scan
from svc_ros.core.se3 import apply
from svc_ros.core.sight.evidence import SeenSurface
from svc_ros.core.sight.weak_directions import Motion, WeakDirection
from svc_ros.ros.streams.decision import Decision, Look
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics import looks
from svc_ros.ros.topics.looks import LookOutputs

TOPICS = ("~/aligned", "~/blocked_points", "~/sight_lines")
MADE_BY = {"~/aligned": "cloud_message", "~/blocked_points": "blocked_points", "~/sight_lines": "sight_line_markers"}


class StandIn:
    """A node whose publishers have readers where that is said, and write down what is sent."""

    def __init__(self, read: tuple[str, ...]) -> None:
        self._read, self.sent = read, []

    def create_publisher(self, _kind, topic, _qos):
        node = self

        class Publisher:
            def get_subscription_count(self):
                return int(topic in node._read)

            def publish(self, message):
                node.sent.append((topic, message))

        return Publisher()


@pytest.fixture(scope="module")
def decision():
    config = preset("lidar_indoor")
    source, target = (prepare(Scan(scan_room(POSES[k], seed=k)), config) for k in (1, 0))
    T = pose_between(1, 0)
    result = verify(source, target, T, config)
    assert result.accepted
    look = Look(source.points, source, target, T, np.eye(4), "lidar")
    return Decision(result, CloudLabel(1, "lidar"), CloudLabel(0, "lidar"), look=look)


@pytest.mark.parametrize("read", [(), *((topic,) for topic in TOPICS), TOPICS])
def test_nothing_is_made_that_nobody_looks_at(decision, monkeypatch, read):
    def never(*_args):
        raise AssertionError("made for nobody")

    for topic, maker in MADE_BY.items():
        if topic not in read and not (maker == "cloud_message" and "~/blocked_points" in read):
            monkeypatch.setattr(looks, maker, never)
    node = StandIn(read)
    LookOutputs(node).publish(decision)
    assert [topic for topic, _ in node.sent] == list(read)


def test_sight_lines_are_capped_and_begin_by_deleting_the_last(decision, monkeypatch):
    monkeypatch.setattr(looks, "MAX_LINES", 7)
    node = StandIn(("~/sight_lines",))
    LookOutputs(node).publish(decision)
    ((_, array),) = node.sent
    assert array.markers[0].action == looks.Marker.DELETEALL
    lines = [marker for marker in array.markers if marker.type == looks.Marker.LINE_LIST]
    assert lines
    assert all(0 < len(marker.points) <= 14 for marker in lines)


def test_denied_surface_comes_as_red_points_beside_the_lines(decision, monkeypatch):
    denied = SeenSurface(100, 50, np.arange(0, 40, 4), 0.0, 0, 0)
    evidence = dataclasses.replace(decision.result.evidence, source_surface=denied)
    array = looks.sight_line_markers(decision.look, evidence, 1)
    (marker,) = [marker for marker in array.markers if marker.ns == "source_denied"]
    assert (marker.type, marker.header.frame_id) == (looks.Marker.POINTS, "lidar")
    assert (marker.color.r, marker.color.g, marker.color.a) == pytest.approx((0.9, 0.1, 1.0))
    assert marker.scale.x == marker.scale.y == pytest.approx(0.5 * decision.look.source.voxel_size_m)
    placed = apply(decision.look.T_target_source, decision.look.source.points[denied.denied_idx])
    np.testing.assert_allclose([(p.x, p.y, p.z) for p in marker.points], placed, atol=1e-9)
    monkeypatch.setattr(looks, "MAX_DENIED", 3)
    array = looks.sight_line_markers(decision.look, evidence, 1)
    assert [len(marker.points) for marker in array.markers if marker.ns == "source_denied"] == [3]


def test_a_decision_without_a_judged_pose_draws_nothing(decision):
    node = StandIn(TOPICS)
    LookOutputs(node).publish(Decision(decision.result, decision.source, decision.target))
    assert node.sent == []


def test_the_text_tells_weak_directions_where_there_are_any(decision):
    weak = (WeakDirection(Motion.SHIFT, np.eye(3)[0], 0.01), WeakDirection(Motion.TURN, np.eye(3)[2], 0.0))
    for found, text in ((weak, "accepted: ok\nweak: x, yaw"), ((), "accepted: ok"), (None, "accepted: ok")):
        result = dataclasses.replace(decision.result, weak_directions=found)
        assert looks.verdict_marker(decision.look, result, 1).text == text
