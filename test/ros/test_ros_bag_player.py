"""Playing a bag as pairs, to the node in a second process, from a third."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from mini_data import POSES, pose_between, scan_room
from ros_bench import SECOND, Bench, StreamBench, cloud, matrix
from yardstick import PATIENCE_S

from svc_ros.core.se3 import pose_error
from svc_ros.io.bags import Bag, CloudBagWriter
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.ros.bag_player import pairs_from_clouds, ros_cloud, with_stamp_of
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id

pytestmark = pytest.mark.dds


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "room"
    with CloudBagWriter(path) as writer:
        for k, T in enumerate(POSES):
            writer.write_points((k + 1) * SECOND, "lidar", scan_room(T, seed=k))
    return path


@pytest.mark.parametrize("stride", [1, 2, 3])
def test_source_is_stride_scans_after_the_target_and_gives_both_its_stamp(stride):
    clouds = [cloud(np.full((1, 3), float(k)), k) for k in range(5)]
    pairs = list(pairs_from_clouds(clouds, stride))
    assert len(pairs) == 5 - stride
    for k, (source, target) in enumerate(pairs):
        assert source == clouds[k + stride]
        assert target.data == clouds[k].data
        assert target.header.stamp == source.header.stamp
        assert clouds[k].header.stamp.sec == k  # what was recorded is not changed


def test_recorded_cloud_is_republished_byte_for_byte(bag_path):
    with Bag(bag_path) as bag:
        recorded = [message for _, message in bag.raw_clouds()]
    for message in recorded:
        sent = ros_cloud(message)
        assert bytes(sent.data) == message.data.tobytes()
        assert [(f.name, f.offset, f.datatype, f.count) for f in sent.fields] == [
            (f.name, f.offset, f.datatype, f.count) for f in message.fields
        ]
        for name in ("height", "width", "point_step", "row_step", "is_bigendian", "is_dense"):
            assert getattr(sent, name) == getattr(message, name)
        assert ns_from_stamp(sent.header.stamp) == ns_from_stamp(message.header.stamp)
        assert sent.header.frame_id == message.header.frame_id


def test_restamped_cloud_keeps_its_frame():
    restamped = with_stamp_of(cloud(np.ones((2, 3)), 1.0, "target"), cloud(np.ones((1, 3)), 2.0, "source"))
    assert (restamped.header.stamp.sec, restamped.header.frame_id, restamped.width) == (2, "target", 2)


@pytest.mark.slow
def test_bag_is_played_and_every_pair_is_decided(bag_path, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id = own_domain_id(6)
    args = [str(bag_path), "--rate", "0", "--wait-decisions"]
    with (
        Bench(tmp_path, domain_id, {"preset": "lidar_indoor"}) as bench,  # live: only back-pressure keeps every pair
        ChildProcess("svc_ros.ros.bag_player", args, local_environment(domain_id), tmp_path / "player.log") as player,
    ):
        assert bench.collector.wait_for_decisions(2, PATIENCE_S), player.output() + bench.process.output()
        assert player.wait(PATIENCE_S) == 0, player.output()
        assert "2 pairs played" in player.output()
        bench.settle()
    assert [(d["verdict"], d["source_stamp"]) for d in bench.answers.decisions] == [
        ("accepted", "2.000000000"),
        ("accepted", "3.000000000"),
    ]
    for k, transform in enumerate(bench.answers.transforms):
        assert pose_error(matrix(transform), pose_between(k + 1, k))[1] < 0.1


def test_bag_is_played_as_scans_and_every_scan_is_decided(bag_path, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id = own_domain_id(8)
    args = [str(bag_path), "--scans", "--rate", "0", "--wait-decisions"]
    with (
        StreamBench(tmp_path, domain_id, {"mode": "scan_matching", "preset": "lidar_indoor"}) as bench,
        ChildProcess("svc_ros.ros.bag_player", args, local_environment(domain_id), tmp_path / "player.log") as player,
    ):
        assert bench.collector.wait_for_decisions(3, PATIENCE_S), player.output() + bench.process.output()
        assert player.wait(PATIENCE_S) == 0, player.output()
        assert "3 scans played" in player.output()
    assert [d["source_stamp"] for d in bench.answers.decisions] == [f"{k}.000000000" for k in (1, 2, 3)]
    assert bench.answers.decisions[0]["origin"] == "start"


@pytest.mark.parametrize(
    ("args", "exit_code", "text"),
    [
        (["no_such_bag"], 2, "no_such_bag"),
        (["BAG", "--topic", "/camera"], 2, "/camera"),
        (["BAG", "--stride", "9"], 2, "expected more than 9 clouds for stride 9"),
        (["BAG", "--stride", "0"], 2, "expected a whole number from 1, found 0"),
        (
            ["BAG", "--wait-for-subscribers", "0.2"],
            1,
            "nobody subscribed to /source_points and /target_points",
        ),
    ],
)
def test_what_cannot_be_played_is_one_line(bag_path, args, exit_code, text):
    command = [sys.executable, "-m", "svc_ros.ros.bag_player", *(str(bag_path) if a == "BAG" else a for a in args)]
    environment = local_environment(own_domain_id(7))
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert run.returncode == exit_code
    assert text in run.stderr.splitlines()[-1]
    assert "Traceback" not in run.stderr
