"""Malformed clouds through the running node: each gets its decision with the right reason, and the node goes on."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from cloud_fuzz import broken_cloud, right_cloud
from cloud_messages import Cloud, xyz_cloud
from mini_data import POSES, scan_room, sensor_pose
from ros_bench import SECOND, Bench, NodeBench, StreamBench, cloud
from yardstick import PATIENCE_S

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.ros.processes import own_domain_id

pytestmark = pytest.mark.dds

NUM_PAIRS, NUM_SCANS, GROUP = 200, 60, 10
SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]
UINT32, UINT8 = 2**32, 2**8


@pytest.fixture(autouse=True)
def _local_discovery(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def fits_a_message(cloud: Cloud) -> bool:
    """True if the middleware can carry it: sizes of 32 bits without a sign."""
    sizes = [cloud.width, cloud.height, cloud.point_step, cloud.row_step]
    sizes += [number for f in cloud.fields for number in (f.offset, f.count)]
    return all(0 <= n < UINT32 for n in sizes) and all(0 <= f.datatype < UINT8 for f in cloud.fields)


def broken_clouds(count: int) -> Iterator[Cloud]:
    """Every second one is a scan of the room, thinned; the others have any layout."""
    found, seed = 0, 0
    while found < count:
        rng = random.Random(seed := seed + 1)
        right = xyz_cloud(SCANS[1][:: rng.choice((1, 4, 4))]) if found % 2 else right_cloud(rng)
        broken, _ = broken_cloud(rng, right)
        if fits_a_message(broken):
            found += 1
            yield broken


def is_refused(cloud: Cloud) -> bool:
    try:
        scan_from_cloud(cloud.message())
    except UnsupportedCloudError:
        return True
    return False


def decisions_on(bench: NodeBench, stamps: list[int]) -> list[dict[str, str]]:
    """The one decision on each stamp [s]."""
    found = [bench.decisions_on(stamp * SECOND) for stamp in stamps]
    assert [len(decisions) for decisions in found] == [1] * len(stamps), bench.process.output()
    return [decisions[0] for decisions in found]


@pytest.mark.slow
def test_200_malformed_pairs_have_a_decision_each_and_the_next_pair_is_registered(tmp_path):
    broken, reasons = list(broken_clouds(NUM_PAIRS)), Counter()
    with Bench(tmp_path, own_domain_id(60), {"preset": "lidar_indoor", "process_every": "true"}) as bench:
        for first in range(0, NUM_PAIRS, GROUP):
            stamps = list(range(first + 1, first + GROUP + 1))
            sides = ["target" if stamp % 5 == 0 else "source" for stamp in stamps]
            for stamp, side in zip(stamps, sides, strict=True):
                bad = replace(broken[stamp - 1], stamp_ns=stamp * SECOND).message("rclpy")
                pair = {"source": cloud(SCANS[2], stamp), "target": cloud(SCANS[0], stamp), side: bad}
                bench.player.publish(pair["source"], pair["target"])
                bench.pause(0.01)
            assert bench.collector.wait_for_decision_on(stamps[-1] * SECOND, PATIENCE_S), bench.process.output()
            for stamp, side, decision in zip(stamps, sides, decisions_on(bench, stamps), strict=True):
                check(decision, broken[stamp - 1], f"{side}: ")
                reasons[decision["reason"]] += 1
            good = bench.decide(cloud(SCANS[1], stamps[-1] + 0.5), cloud(SCANS[0], stamps[-1] + 0.5))
            assert good["verdict"] == "accepted", good
        counts = bench.status()
    assert counts["jobs"] == {"received": NUM_PAIRS + NUM_PAIRS // GROUP, "pending": 0, "without_candidate": 0}
    assert "Traceback" not in bench.process.output()
    assert reasons["unsupported_cloud"] > NUM_PAIRS / 4  # and the others were read
    assert reasons["too_few_points"] > NUM_PAIRS / 20
    assert sum(reasons.values()) - reasons["unsupported_cloud"] - reasons["too_few_points"] > NUM_PAIRS / 20


@pytest.mark.slow
def test_malformed_scans_of_a_stream_have_a_decision_each_and_the_next_scan_goes_on(tmp_path):
    broken = list(broken_clouds(NUM_SCANS))
    parameters = {"mode": "scan_matching", "preset": "lidar_indoor", "process_every": "true"}
    with StreamBench(tmp_path, own_domain_id(61), parameters) as bench:
        for k, bad in enumerate(broken):
            stamp = 2 * k + 1
            good = bench.decide(room(k, stamp))
            assert good["verdict"] == "accepted", (k, good)
            bad = replace(bad, stamp_ns=(stamp + 1) * SECOND)
            decision = bench.decide(bad.message("rclpy"))
            check(decision, bad, "")
        counts = bench.status()
    assert counts["jobs"] == {"received": 2 * NUM_SCANS, "pending": 0, "without_candidate": 0}
    assert len(bench.answers.decisions) == 2 * NUM_SCANS
    assert "Traceback" not in bench.process.output()


def room(k: int, stamp_s: float):
    """The room from a place that goes back and forth."""
    place = abs(k % 10 - 5)
    return cloud(scan_room(sensor_pose(0.1 * place, 0.05 * place, place), seed=k), stamp_s)


def check(decision: dict[str, str], broken: Cloud, start: str) -> None:
    """Refused as a cloud that cannot be read where that is so, and judged as what it holds where it can."""
    assert decision["reason"] != "internal_error", decision
    if is_refused(broken):
        assert (decision["verdict"], decision["reason"]) == ("rejected", "unsupported_cloud"), decision
        assert decision["detail"].startswith(f"{start}PointCloud2 in frame")
    elif broken.frame_id == "lidar":  # a stream stays with its first frame
        assert decision["reason"] != "unsupported_cloud", decision
