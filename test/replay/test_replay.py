"""A bag through the registration: exactly one decision a pair, whatever the clouds are like."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mini_data
import numpy as np
import pytest

from svc_ros.core import registration
from svc_ros.core.config import preset
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.se3 import make_pose, pose_error
from svc_ros.io.bags import Bag, CloudBagWriter
from svc_ros.replay import stream_pairs as replay
from svc_ros.replay.stream_pairs import replay_pairs

CONFIG = preset("lidar_indoor")
START_NS = 1_700_000_000_123_456_789
STEP_NS = 100_000_000
MOUNTING = make_pose(np.eye(3), (0.3, 0.0, 1.2))


def write_room_bag(path: Path, order: tuple[int, ...], in_base: bool = False) -> Path:
    """Scans of the room in the given order; `in_base`: moved into the frame base_link, with the mounting in TF."""
    with CloudBagWriter(path) as bag:
        if in_base:
            bag.write_transform(START_NS, "base_link", "lidar", MOUNTING, static=True)
        for k, place in enumerate(order):
            points = mini_data.scan_room(mini_data.POSES[place], seed=k)
            frame = "base_link" if in_base else "lidar"
            points = points + MOUNTING[:3, 3] if in_base else points
            bag.write_points(START_NS + k * STEP_NS, frame, points)
    return path


class DamagedBag(Bag):
    """A bag of which some clouds are changed on the way: index -> fields to replace."""

    changes: dict[int, dict[str, Any]]

    def raw_clouds(self, topic: str | None = None, span_ns: tuple[int, int] | None = None) -> Iterator[tuple[int, Any]]:
        for k, (stamp, msg) in enumerate(super().raw_clouds(topic, span_ns)):
            yield stamp, dataclasses.replace(msg, **self.changes.get(k, {}))


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("replay") / "room", (0, 1, 2, 1))


def test_each_scan_is_the_source_against_the_one_before(bag_path):
    with Bag(bag_path) as bag:
        pairs = list(replay_pairs(bag, "/points", CONFIG))
    assert [(p.source_index, p.target_index) for p in pairs] == [(1, 0), (2, 1), (3, 2)]
    assert [p.source_stamp_ns - p.target_stamp_ns for p in pairs] == [STEP_NS] * 3
    assert pairs[0].target_stamp_ns == START_NS
    assert (pairs[0].source_frame, pairs[0].target_frame) == ("lidar", "lidar")
    for pair, (source, target) in zip(pairs, [(1, 0), (2, 1), (1, 2)], strict=True):
        assert pair.result.accepted
        angle, distance = pose_error(pair.result.T_target_source, mini_data.pose_between(source, target))
        assert angle < 1.0
        assert distance < 0.1


def test_a_stride_skips_scans_and_a_short_bag_has_no_pairs(bag_path):
    with Bag(bag_path) as bag:
        assert [(p.source_index, p.target_index) for p in replay_pairs(bag, "/points", CONFIG, 2)] == [(2, 0), (3, 1)]
        assert list(replay_pairs(bag, "/points", CONFIG, 4)) == []


def test_features_are_computed_once_a_scan(bag_path, monkeypatch):
    calls = []

    def counting(scan, config):
        calls.append(scan.stamp_ns)
        return registration.extract_features(scan, config)

    monkeypatch.setattr(replay, "extract_features", counting)
    with Bag(bag_path) as bag:
        assert len(list(replay_pairs(bag, "/points", CONFIG))) == 3
    assert calls == [START_NS + k * STEP_NS for k in range(4)]


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ({"fields": []}, Reason.UNSUPPORTED_CLOUD),
        ({"data": np.zeros(7, np.uint8)}, Reason.UNSUPPORTED_CLOUD),
        ({"width": 20, "row_step": 20 * 16, "data": np.zeros(20 * 16, np.uint8)}, Reason.TOO_FEW_POINTS),
    ],
)
def test_a_bad_cloud_rejects_its_two_pairs_and_no_other(bag_path, damage, reason):
    bag = DamagedBag(bag_path)
    bag.changes = {1: damage}
    with bag:
        pairs = list(replay_pairs(bag, "/points", CONFIG))
    assert [(p.source_index, p.target_index) for p in pairs] == [(1, 0), (2, 1), (3, 2)]
    assert [p.result.verdict for p in pairs] == [Verdict.REJECTED, Verdict.REJECTED, Verdict.ACCEPTED]
    assert [p.result.reason for p in pairs[:2]] == [reason, reason]
    assert pairs[0].result.detail.startswith("source (scan 1): ")
    assert pairs[1].result.detail.startswith("target (scan 1): ")


def test_the_sensor_of_a_cloud_in_another_frame_comes_from_tf(tmp_path, monkeypatch):
    path = write_room_bag(tmp_path / "base", (0, 1), in_base=True)
    origins = []

    def recording(scan, config):
        origins.append(scan.sensor_origin)
        return registration.extract_features(scan, config)

    monkeypatch.setattr(replay, "extract_features", recording)
    with Bag(path) as bag:
        (pair,) = replay_pairs(bag, "/points", CONFIG, sensor_frame="lidar")
    np.testing.assert_allclose(origins, [MOUNTING[:3, 3]] * 2)
    assert pair.result.accepted


def test_a_missing_transform_is_a_decision_that_names_the_frames(bag_path):
    with Bag(bag_path) as bag:
        pairs = list(replay_pairs(bag, "/points", CONFIG, sensor_frame="mast"))
    assert [p.result.reason for p in pairs] == [Reason.TF_UNAVAILABLE] * 3
    assert "mast" in pairs[0].result.detail
    assert "lidar" in pairs[0].result.detail


def test_a_stride_below_one_is_refused(bag_path):
    with Bag(bag_path) as bag, pytest.raises(InputError, match="stride"):
        next(replay_pairs(bag, "/points", CONFIG, 0))


def test_both_recordings_of_the_walk_decide_every_pair(shared_data):
    folder = shared_data / "bags" / "os0_64_walk"
    decided = []
    for path in (folder / "ros2_mcap", folder / "ros1_first22.bag"):
        with Bag(path) as bag:
            pairs = replay_pairs(bag, bag.resolve_cloud_topic(None), CONFIG)
            decided.append([next(pairs), next(pairs)])
    for first, second in zip(*decided, strict=True):
        assert (first.source_stamp_ns, first.source_index) == (second.source_stamp_ns, second.source_index)
        assert first.result.accepted
        np.testing.assert_array_equal(first.result.T_target_source, second.result.T_target_source)
