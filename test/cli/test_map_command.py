"""`svc_ros map` on bags of the furnished room, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from assertions import assert_given_back, assert_same_pose
from command_line import assert_refused, run
from replay_cases import WAY, write_room_bag

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.io.config_yaml import config_to_yaml
from svc_ros.io.trajectories import read_tum
from svc_ros.pipeline.map import Map
from svc_ros.simulation import DriveConfig, simulate_drive

pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")

ODOMETRY = ("--odometry-frame", "odom")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("bags") / "room", broken=(1,))


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "mine.yaml"
    changes = {"loop_closure.keyframe_distance_m": 0.2, "agreement.independent_m": 0.3}
    path.write_text(config_to_yaml(with_values(preset("lidar_indoor"), changes), "lidar_indoor"))
    return path


def test_a_bag_becomes_a_map_which_further_bags_extend(bag: Path, config: Path, tmp_path: Path) -> None:
    first = run("map", bag, "--out", tmp_path / "map", "--config", config, "--duration", "0.35", *ODOMETRY)
    assert first.exit_code == 0, first.output
    assert_given_back(tmp_path / "map")
    with Map.read(tmp_path / "map") as found:
        assert found.keyframe(0).scan.frame_id == "lidar"
    assert [each.source for each in found.runs] == ["room"]
    assert found.config.loop_closure.keyframe_distance_m == 0.2
    for T, truth in zip(found.poses, [WAY[0], *WAY[2:4]], strict=True):  # the second cloud is broken
        assert_same_pose(T, truth, 0.1, 0.01)

    second = run("map", bag, "--out", tmp_path / "more", "--extend", tmp_path / "map", "--start", "0.35", *ODOMETRY)
    assert second.exit_code == 0, second.output
    assert_given_back(tmp_path / "map")
    assert_given_back(tmp_path / "more")
    with Map.read(tmp_path / "more") as whole:
        assert len(whole) == 6
    assert whole.sessions.tolist() == [0, 0, 0, 1, 1, 1]
    assert whole.config == found.config
    assert "loops between runs" in second.stdout
    for T, truth in zip(whole.poses[3:], WAY[4:], strict=True):
        assert_same_pose(T, truth, 0.5, 0.05)


def test_without_an_odometry_frame_the_way_is_found_by_scan_matching(bag: Path, config: Path, tmp_path: Path) -> None:
    done = run("map", bag, "--out", tmp_path / "map", "--config", config, "--duration", "0.35")
    assert done.exit_code == 0, done.output
    found = Map.read(tmp_path / "map")
    assert_same_pose(found.poses[-1], se3.invert(WAY[0]) @ WAY[3], 0.5, 0.05)
    np.testing.assert_array_equal(found.poses[0], np.eye(4))


def test_what_is_refused(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    assert_refused(run("map", bag, "--out", tmp_path / "mine"), "expected a new folder", "other files")
    assert_refused(run("map", tmp_path / "no", "--out", tmp_path / "map"), str(tmp_path / "no"))
    assert_refused(run("map", bag, "--out", tmp_path / "map", "--extend", tmp_path / "no"), "folder of a map")
    assert_refused(run("map", bag, "--out", tmp_path / "map", "--odometry-frame", "none"), "--odometry-frame none")
    assert not (tmp_path / "map").exists()


def test_a_map_that_is_extended_has_its_own_preset(bag: Path, config: Path, tmp_path: Path) -> None:
    made = run("map", bag, "--out", tmp_path / "map", "--config", config, "--duration", "0.35", *ODOMETRY)
    assert made.exit_code == 0, made.output
    extended = ("--out", tmp_path / "more", "--extend", tmp_path / "map")
    assert_refused(run("map", bag, *extended, "--preset", "lidar_outdoor"), "--preset lidar_outdoor", "--extend")
    other = tmp_path / "other.yaml"
    other.write_text("preprocess: {voxel_size_m: 0.2}")
    # before the bag, which has no such topic, is read; and it is the file's fault, not the map's
    refused = run("map", bag, *extended, "--config", other, "--topic", "/none")
    assert_refused(refused, "other.yaml: expected preprocess.voxel_size_m 0.3", "found 0.2")


def assert_as_the_reference(found: Map, reference: Path, m: float) -> None:
    """Each pose as the reference has it, both relative to the first one."""
    truth = read_tum(reference)
    begin = se3.invert(truth.at(int(found.stamps_ns[0])))
    for stamp_ns, T in zip(found.stamps_ns.tolist(), found.poses, strict=True):
        assert_same_pose(se3.invert(found.poses[0]) @ T, begin @ truth.at(stamp_ns), 2.0, m)


@pytest.mark.slow
def test_both_halves_of_a_walk_become_one_map(shared_data: Path, tmp_path: Path) -> None:
    walk = shared_data / "bags" / "os0_64_walk"
    first = run("map", walk / "ros2_mcap", "--out", tmp_path / "first", "--duration", "44")
    assert first.exit_code == 0, first.output
    assert_as_the_reference(Map.read(tmp_path / "first"), walk / "reference_tum.txt", 0.1)
    second = run("map", walk / "ros2_mcap", "--out", tmp_path / "both", "--start", "44", "--extend", tmp_path / "first")
    assert second.exit_code == 0, second.output
    both = Map.read(tmp_path / "both")
    assert both.config.preprocess == preset("lidar_indoor").preprocess
    assert_as_the_reference(both, walk / "reference_tum.txt", 0.1)
    assert sum(both.sessions[edge.source] != both.sessions[edge.target] for edge in both.graph.edges) >= 10


@pytest.mark.slow
def test_a_simulated_street_becomes_a_map(tmp_path: Path) -> None:
    drive = simulate_drive(tmp_path, DriveConfig(num_scans=16, rate_hz=0.5, seed=3, there_and_back=True))
    done = run("map", drive.bag, "--out", tmp_path / "map", "--preset", "lidar_outdoor")
    assert done.exit_code == 0, done.output
    found = Map.read(tmp_path / "map")
    assert len(found) >= 12
    assert len(found.graph.edges) > len(found)
    assert_as_the_reference(found, drive.reference, 0.15)
