"""What a recorded decision shows: the numbers, their messages, and that they are those of the node."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_recorder import START, S, messages_of
from replay_cases import CONFIG, WAY, write_room_bag

from svc_ros.core import se3
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.sight.evidence import SeenSurface, SightLines
from svc_ros.io.bags import Bag
from svc_ros.io.bags.pictures import LineGroup, Picture, PointGroup
from svc_ros.io.bags.result_writer import RecordedTopic, ResultWriter
from svc_ros.replay.clouds import ReplayedPair
from svc_ros.replay.pictures import MAX_DENIED, MAX_LINES, draw
from svc_ros.replay.stream_pairs import replay_pairs

T_ODOM_TARGET = se3.make_pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), (10.0, 20.0, 0.5))


@pytest.fixture(scope="module")
def decision(tmp_path_factory: pytest.TempPathFactory) -> ReplayedPair:
    """Two scans of the room, accepted; some lines are said to be blocked, some points denied."""
    with Bag(write_room_bag(tmp_path_factory.mktemp("pictures") / "room")) as bag:
        found = next(replay_pairs(bag, "/points", CONFIG))
    evidence = found.result.evidence
    assert evidence is not None
    lines = SightLines(500, 400, np.array([3, 7, 9]), np.array([1, 2, 3]))
    surface = SeenSurface(500, 100, np.array([2, 5]), 1.0, 0, 0)
    told = dataclasses.replace(evidence, source_in_target=lines, source_surface=surface)
    return dataclasses.replace(found, result=dataclasses.replace(found.result, evidence=told))


def wrote(tmp_path: Path, picture: Picture) -> dict[str, Any]:
    with ResultWriter(tmp_path / "results.mcap") as writer:
        writer.write_picture(picture, START + S)
    found = messages_of(tmp_path / "results.mcap")
    return {topic.rpartition("/")[2]: messages[0][1] for topic, messages in found.items()}


def test_a_picture_stands_in_the_odometry_frame_where_that_is_known(decision: ReplayedPair) -> None:
    in_target = draw(decision, "odom")
    in_odom = draw(dataclasses.replace(decision, T_odom_target=T_ODOM_TARGET), "odom")
    assert in_target is not None
    assert in_odom is not None
    assert (in_target.frame_id, in_odom.frame_id) == ("lidar", "odom")
    assert decision.scans is not None
    source, target = decision.scans
    T = se3.invert(WAY[0]) @ WAY[1]
    np.testing.assert_allclose(in_target.aligned, se3.apply(T, source.points), atol=0.05)
    np.testing.assert_allclose(in_odom.aligned, se3.apply(T_ODOM_TARGET, in_target.aligned), atol=1e-9)
    np.testing.assert_array_equal(in_target.blocked[:3], target.points[[3, 7, 9]])
    np.testing.assert_array_equal(in_target.from_source[:3], 0.0)
    assert in_target.from_source[3:].all()


def test_lines_are_few_and_told_apart_by_colour(decision: ReplayedPair) -> None:
    picture = draw(decision, "odom")
    assert picture is not None
    groups = {group.namespace: group for group in picture.lines}
    assert len(groups["target_clear"].ends) == MAX_LINES
    assert len(groups["target_blocked"].ends) == 3
    assert groups["target_clear"].colour[1] > groups["target_clear"].colour[0]
    assert groups["target_blocked"].colour[0] > groups["target_blocked"].colour[1]
    np.testing.assert_allclose(groups["source_clear"].origin, (se3.invert(WAY[0]) @ WAY[1])[:3, 3], atol=0.05)
    assert picture.label == "accepted: ok"


def test_denied_surface_is_red_points_where_the_pose_puts_them(decision: ReplayedPair) -> None:
    picture = draw(decision, "odom")
    assert picture is not None
    assert decision.scans is not None
    source = decision.scans[0]
    groups = {group.namespace: group for group in picture.denied}
    placed = se3.apply(decision.result.best_candidate, source.points[[2, 5]])
    np.testing.assert_allclose(groups["source_denied"].points, placed, atol=1e-9)
    assert groups["source_denied"].colour[0] > groups["source_denied"].colour[1]
    assert groups["source_denied"].size_m == pytest.approx(0.5 * source.voxel_size_m)
    assert all(len(group.points) <= MAX_DENIED for group in picture.denied)


def test_what_was_not_judged_has_no_picture_and_what_was_rejected_no_aligned_cloud(decision: ReplayedPair) -> None:
    assert draw(dataclasses.replace(decision, scans=None), "odom") is None
    result = decision.result
    rejected = RegistrationResult(
        Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED, best_candidate=result.best_candidate, evidence=result.evidence
    )
    picture = draw(dataclasses.replace(decision, result=rejected), "odom")
    assert picture is not None
    assert picture.aligned is None
    assert picture.label == "rejected: sight_view_blocked"
    assert picture.label_colour[0] > picture.label_colour[1]


def small_picture(aligned: bool = True) -> Picture:
    ends = np.array([[1.0, 2, 3], [4, 5, 6]])
    lines = [LineGroup("target_blocked", 1, (0.9, 0.1, 0.1, 1.0), np.array([0.0, 0, 1]), ends)]
    cloud = np.arange(6.0).reshape(2, 3) if aligned else None
    red = (0.9, 0.1, 0.1, 1.0)
    denied = [PointGroup("source_denied", 2, red, ends, 0.15)]
    return Picture(
        "odom", cloud, np.array([[7.0, 8, 9]]), np.array([1.0]), lines, denied, "rejected: low_overlap",
        np.array([1.0, 1, 1]), red,
    )  # fmt: skip


def test_messages_of_a_picture(tmp_path: Path) -> None:
    found = wrote(tmp_path, small_picture())
    assert set(found) == {"aligned", "blocked_points", "sight_lines"}
    first, lines, denied, label = found["sight_lines"].markers
    assert (first.action, lines.action, label.action) == (3, 0, 0)
    assert (lines.ns, lines.id, lines.type, lines.scale.x) == ("target_blocked", 1, 5, 0.02)
    assert [(p.x, p.y, p.z) for p in lines.points] == [(0, 0, 1), (1, 2, 3), (0, 0, 1), (4, 5, 6)]
    assert (lines.color.r, lines.color.a) == (pytest.approx(0.9), 1.0)
    assert (denied.ns, denied.id, denied.type, denied.scale.x, denied.scale.y) == ("source_denied", 2, 8, 0.15, 0.15)
    assert [(p.x, p.y, p.z) for p in denied.points] == [(1, 2, 3), (4, 5, 6)]
    assert (label.text, label.type, label.pose.position.z) == ("rejected: low_overlap", 9, 2.0)
    for message in (first, lines, denied, label, found["aligned"], found["blocked_points"]):
        assert (message.header.frame_id, message.header.stamp.sec) == ("odom", START // S + 1)
    assert found["aligned"].data.view("<f4").tolist() == [0, 1, 2, 3, 4, 5]
    assert [field.name for field in found["blocked_points"].fields] == ["x", "y", "z", "from_source"]
    assert found["blocked_points"].data.view("<f4").tolist() == [7, 8, 9, 1]


def test_without_an_aligned_cloud_there_is_no_such_message(tmp_path: Path) -> None:
    assert "aligned" not in wrote(tmp_path, small_picture(aligned=False))


def test_the_node_draws_the_same(decision: ReplayedPair, tmp_path: Path) -> None:
    """Frames, names, colours, sizes and points of all markers, and both clouds."""
    pytest.importorskip("rclpy")
    from svc_ros.ros.streams.decision import Look
    from svc_ros.ros.topics import looks

    picture, result = draw(decision, "odom"), decision.result
    assert picture is not None
    assert decision.scans is not None
    assert result.evidence is not None
    recorded = wrote(tmp_path, picture)
    source, target = decision.scans
    look = Look(source.points, source, target, result.best_candidate, np.eye(4), "lidar")
    markers = looks.sight_line_markers(look, result.evidence, START + S)
    markers.markers.append(looks.verdict_marker(look, result, START + S))
    assert len(recorded["sight_lines"].markers) == len(markers.markers)
    for found, expected in zip(recorded["sight_lines"].markers, markers.markers, strict=True):
        for name in ("ns", "id", "type", "action", "text"):
            assert getattr(found, name) == getattr(expected, name), name
        assert found.header.frame_id == expected.header.frame_id
        for part, names in (("color", "rgba"), ("scale", "xyz")):
            first, second = getattr(found, part), getattr(expected, part)
            values = [[getattr(side, name) for name in names] for side in (first, second)]
            np.testing.assert_allclose(*values, atol=1e-6)
        points = [[(p.x, p.y, p.z) for p in side.points] for side in (found, expected)]
        np.testing.assert_allclose(*points, atol=1e-9)
        ends = [(side.pose.position.x, side.pose.position.y, side.pose.position.z) for side in (found, expected)]
        np.testing.assert_allclose(*ends, atol=1e-9)
    blocked, from_source = looks.blocked_points(look, result.evidence)
    np.testing.assert_allclose(picture.blocked, blocked, atol=1e-9)
    np.testing.assert_array_equal(picture.from_source, from_source)


def test_recorded_messages_are_written_with_their_time(tmp_path: Path) -> None:
    bag = write_room_bag(tmp_path / "room")
    with Bag(bag) as recorded, ResultWriter(tmp_path / "results.mcap") as writer:
        for topic, time_ns, message in recorded.transform_messages():
            is_static = topic == "/tf_static"
            writer.write_recorded(RecordedTopic(topic, "tf2_msgs/msg/TFMessage", is_static), time_ns, message)
    with Bag(bag) as recorded, Bag(tmp_path / "results.mcap") as copy:
        stamps = [[time for _, time, _ in side.transform_messages()] for side in (recorded, copy)]
        assert stamps[0] == stamps[1]
        poses = [side.transforms().lookup("odom", "lidar", stamps[0][-1]) for side in (recorded, copy)]
    np.testing.assert_array_equal(*poses)


def test_a_decision_tells_what_the_node_tells(decision: ReplayedPair, tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "results.mcap") as writer:
        stamps = decision.source_stamp_ns, decision.target_stamp_ns
        writer.write(decision.result, *stamps, "lidar", "lidar", origin="motion")
    ((_, message),) = messages_of(tmp_path / "results.mcap")["/svc_registration/decision"]
    values = {pair.key: pair.value for pair in message.status[0].values}
    assert (values["source_frame"], values["target_frame"], values["origin"]) == ("lidar", "lidar", "motion")
    np.testing.assert_array_equal(json.loads(values["T_target_source"]), decision.result.T_target_source)
    np.testing.assert_array_equal(json.loads(values["best_candidate"]), decision.result.best_candidate)
