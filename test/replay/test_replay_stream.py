"""A bag through scan matching and loop closure: every cloud has its decision, and odometry may come from anywhere."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mini_data
import numpy as np
import pytest
from map_in_memory import MapInMemory
from scipy.spatial.transform import Rotation
from yardstick import Stopwatch

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason
from svc_ros.core.scan import Scan
from svc_ros.io.bags import Bag, CloudBagWriter
from svc_ros.io.g2o import read_g2o, write_g2o
from svc_ros.io.trajectories import read_tum
from svc_ros.pipeline.localisation import LocalisationState, Localiser
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.replay.clouds import RecordedCloud
from svc_ros.replay.stream import (
    TrackedCloud,
    localisation_steps,
    loop_steps,
    matching_steps,
    odometry_by_matching,
    odometry_by_transforms,
    replay_loop_closure,
    replay_scan_matching,
)

CONFIG = with_values(preset("lidar_indoor"), {"loop_closure.min_gap_s": 0.35, "loop_closure.keyframe_distance_m": 0.2})
START_NS, STEP_NS = 1_700_000_000_123_456_789, 100_000_000
WAY = [mini_data.sensor_pose(x, 0.0, 0.0) for x in (0.0, 0.3, 0.6, 0.9, 0.6, 0.3, 0.0)]
FAR = mini_data.sensor_pose(3.0, -1.0, 90.0)
MOUNTING = se3.make_pose(Rotation.from_euler("z", 20, degrees=True).as_matrix(), (0.3, 0.0, 1.2))


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A way out and back through the room; TF odom -> base_link -> lidar."""
    path = tmp_path_factory.mktemp("stream") / "room"
    with CloudBagWriter(path) as bag:
        bag.write_transform(START_NS, "base_link", "lidar", MOUNTING, static=True)
        for k, T in enumerate(WAY):
            stamp = START_NS + k * STEP_NS
            bag.write_transform(stamp, "odom", "base_link", T @ se3.invert(MOUNTING))
            bag.write_points(stamp, "lidar", mini_data.scan_room(T, seed=k))
    return path


class DamagedBag(Bag):
    """A bag whose third cloud lost half of its data."""

    def raw_clouds(self, topic: str | None = None, span_ns: tuple[int, int] | None = None) -> Iterator[tuple[int, Any]]:
        for k, (stamp, msg) in enumerate(super().raw_clouds(topic, span_ns)):
            yield stamp, dataclasses.replace(msg, data=msg.data[: len(msg.data) // 2]) if k == 2 else msg


def test_a_replay_decides_what_the_matcher_decides(bag_path: Path) -> None:
    matcher = ScanMatcher(CONFIG)
    with Bag(bag_path) as bag:
        expected = [decision for reading in bag.scans() for decision in matcher.add(reading.scan)]
        found = list(replay_scan_matching(bag, "/points", CONFIG))
    assert len(found) == len(WAY)
    for first, second in zip(found, expected, strict=True):
        assert first.source_stamp_ns == second.source_stamp_ns
        np.testing.assert_array_equal(first.T_odom_source, second.T_odom_source)


def test_a_damaged_cloud_has_its_decision_and_the_next_goes_on(bag_path: Path) -> None:
    with DamagedBag(bag_path) as bag:
        found = list(replay_scan_matching(bag, "/points", CONFIG))
    assert [d.source_stamp_ns for d in found] == [START_NS + k * STEP_NS for k in range(len(WAY))]
    assert found[2].result.reason is Reason.UNSUPPORTED_CLOUD
    assert [d.result.accepted for d in found] == [True, True, False, True, True, True, True]


def test_a_sensor_frame_without_transform_is_a_reason(bag_path: Path) -> None:
    with Bag(bag_path) as bag:
        found = list(replay_scan_matching(bag, "/points", CONFIG, sensor_frame="camera"))
    assert {d.result.reason for d in found} == {Reason.TF_UNAVAILABLE}
    assert len(found) == len(WAY)


@pytest.mark.parametrize("loop_closure", [False, True])
def test_indices_where_stamps_come_twice_and_time_jumps_back(loop_closure: bool) -> None:
    """A cloud that was recorded twice is dropped; the bag's second round begins anew."""
    order = [0, 1, 1, 2, 3, 4, 5, 6, 0, 1, 2, 3, 4, 5, 6]
    clouds = []
    for n, k in enumerate(order):
        stamp = START_NS + k * 10 * STEP_NS
        scan = Scan(mini_data.scan_room(WAY[k], seed=k), stamp, "lidar")
        clouds.append(RecordedCloud(n, stamp, "lidar", stamp, None, scan=scan))
    if loop_closure:
        closer = LoopCloser(CONFIG)
        tracked = (TrackedCloud(cloud, WAY[order[cloud.index]], 0.0) for cloud in clouds)
        found = [d for step in loop_steps(tracked, closer) for d in step.decisions]
    else:
        found = [d for step in matching_steps(clouds, CONFIG) for d in step.decisions]
        assert [d.source_index for d in found] == list(range(len(order)))
    assert any(d.source_index > 8 for d in found)
    for d in found:
        if d.result.reason is Reason.STALE:
            assert (d.source_index, d.target_index) == (2, 2)
            continue
        assert order[d.target_index] * 10 * STEP_NS + START_NS == d.target_stamp_ns
        assert d.target_index != 2
        assert (d.target_index >= 8) == (d.source_index >= 8)


def test_in_a_map_of_runs_that_share_stamps_the_target_is_the_keyframe_that_judged() -> None:
    """Simulated runs all begin at one time. Clouds that are none for so long are a loss."""
    known = [Scan(mini_data.scan_room(T, seed=20), START_NS, "lidar") for T in (WAY[0], FAR)]
    config = with_values(CONFIG, {"localization.lost_after_s": 1.0, "localization.max_neighbours": 1})
    localiser = Localiser(MapInMemory(known, [WAY[0], FAR], config), config)
    near = FAR @ mini_data.sensor_pose(0.1, 0.1, 3.0)
    near[2, 3] = FAR[2, 3]
    scan = Scan(mini_data.scan_room(near, seed=21), START_NS, "lidar")
    clouds = [
        RecordedCloud(0, START_NS, "lidar", START_NS, None, scan=scan),
        RecordedCloud(1, START_NS + 20 * STEP_NS, "lidar", START_NS, None, error=InputError("half of it is missing")),
    ]
    steps = localisation_steps((TrackedCloud(cloud, near, 0.0) for cloud in clouds), localiser)
    (found,) = next(steps).decisions
    assert found.result.accepted
    assert (found.source_index, found.target_index) == (0, 1)
    np.testing.assert_array_equal(found.T_odom_target, FAR)
    assert localiser.state is LocalisationState.LOCALISED
    (none,) = next(steps).decisions
    assert (none.result.reason, none.target_index) == (Reason.UNSUPPORTED_CLOUD, 1)
    assert localiser.state is LocalisationState.LOST


@pytest.mark.parametrize("source", ["transforms", "matching", "none"])
def test_loops_are_found_with_odometry_from_anywhere(bag_path: Path, tmp_path: Path, source: str) -> None:
    closer = LoopCloser(CONFIG)
    with Bag(bag_path) as bag:
        odometry = {
            "transforms": odometry_by_transforms(bag.transforms(), "odom"),
            "matching": odometry_by_matching(CONFIG),
            "none": lambda scan: None,
        }[source]
        loops = list(replay_loop_closure(bag, "/points", closer, odometry))
    assert {d.origin for d in loops} == {"place" if source == "none" else "odometry"}
    assert all(d.result.accepted for d in loops)
    last = loops[-1]
    assert (last.source_stamp_ns, last.target_stamp_ns) == (START_NS + 6 * STEP_NS, START_NS)
    assert se3.pose_error(last.result.T_target_source, np.eye(4))[1] < 0.05
    if source != "none":
        graph = build_pose_graph(closer.keyframe_poses, loops, CONFIG.covariance)
        write_g2o(tmp_path / "loops.g2o", graph)
        assert len(read_g2o(tmp_path / "loops.g2o").edges) == len(WAY) - 1 + len(loops)


def test_odometry_that_tf_does_not_have_is_no_pose(bag_path: Path) -> None:
    with Bag(bag_path) as bag:
        pose = odometry_by_transforms(bag.transforms(), "map")
        assert pose(Scan(np.zeros((0, 3)), START_NS, "lidar")) is None
        known = odometry_by_transforms(bag.transforms(), "odom")(Scan(np.zeros((0, 3)), START_NS, "lidar"))
    np.testing.assert_allclose(known, WAY[0], atol=1e-9)


@pytest.mark.slow
def test_a_walk_of_88_seconds_is_replayed_with_its_loops(shared_data: Path) -> None:
    config, folder = preset("lidar_indoor"), shared_data / "bags" / "os0_64_walk"
    reference, closer = read_tum(folder / "reference_tum.txt"), LoopCloser(config)
    with Stopwatch() as watch, Bag(folder / "ros2_mcap") as bag:
        loops = list(replay_loop_closure(bag, "/points", closer, odometry_by_matching(config)))
    assert watch.own_s < 88.0, watch
    accepted = [d for d in loops if d.result.accepted]
    assert len(accepted) >= 20
    for d in accepted:
        T = se3.invert(reference.at(d.target_stamp_ns)) @ reference.at(d.source_stamp_ns)
        angle, distance = se3.pose_error(d.result.T_target_source, T)
        assert angle < 5.0
        assert distance < 0.6
