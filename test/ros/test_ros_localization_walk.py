"""A real walk: a map of its first half, the second half localised by the node as by the replay, told poses judged."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
pytest.importorskip("gtsam", reason="needs gtsam (pip install svc_ros[graph])")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import QoSProfile
from ros_bench import SECOND, StreamBench, recorded_clouds
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger
from yardstick import PATIENCE_S

from svc_ros.core.config import preset
from svc_ros.core.se3 import invert, make_pose
from svc_ros.io.bags import Bag
from svc_ros.io.results import decision_values
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.trajectories import read_tum
from svc_ros.pipeline.localisation import Localiser
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.mapping.building import Run, build_map
from svc_ros.replay.clouds import BagPart, read_clouds
from svc_ros.replay.stream import localisation_steps, odometry_by_matching, track_clouds
from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import own_domain_id
from svc_ros.ros.topics.conversions import header, plain_pose

pytestmark = [pytest.mark.dds, pytest.mark.slow]

HALF = 45  # scans, a second apart
ERRORS = {  # of told poses: shift [m] and turn [deg]
    "true": ((0.0, 0.0, 0.0), 0.0), "2 m": ((2.0, 0.0, 0.0), 0.0), "5 m": ((0.0, 5.0, 0.0), 0.0),
    "10 m": ((-7.0, 7.0, 0.0), 0.0), "20 deg": ((0.0, 0.0, 0.0), 20.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def walk(shared_data):
    return shared_data / "bags" / "os0_64_walk"


@pytest.fixture(scope="module")
def first_half(walk, tmp_path_factory) -> Map:
    config, folder = preset("lidar_indoor"), tmp_path_factory.mktemp("maps") / "first_half"
    with Bag(walk / "ros2_mcap") as bag:
        clouds = list(read_clouds(bag, BagPart(bag.cloud_topics[0].name)))[:HALF]
    odometry = odometry_by_matching(config)
    return build_map([Run("first half", [(c.scan, odometry(c.scan)) for c in clouds], config)], folder)


class Places:
    """Where the walk's reference puts a scan in the map's frame: by the keyframe that stood nearest."""

    def __init__(self, site: Map, reference) -> None:
        self._site, self._reference = site, reference
        self._keyframes = np.array([reference.at(int(stamp), SECOND) for stamp in site.stamps_ns])

    def at(self, stamp_ns: int) -> np.ndarray:
        T = self._reference.at(stamp_ns, SECOND)
        nearest = int(np.argmin(np.linalg.norm(self._keyframes[:, :3, 3] - T[:3, 3], axis=1)))
        return self._site.poses[nearest] @ invert(self._keyframes[nearest]) @ T


def replayed(walk, site: Map):
    """Stamp, verdict, origin and probability of every decision on the second half, as the replay makes them."""
    with Bag(walk / "ros2_mcap") as bag:
        clouds = list(read_clouds(bag, BagPart(bag.cloud_topics[0].name)))[HALF:]
    tracked = track_clouds(clouds, odometry_by_matching(site.config))
    steps = localisation_steps(tracked, Localiser(Map.read(site.folder), site.config))
    return [
        (d.source_stamp_ns, d.result.verdict.value, d.origin, decision_values(d.result, 0, 0).get("probability"))
        for step in steps
        for d in step.decisions
    ]


def test_the_node_places_the_second_half_as_the_replay_does_and_knows_wrong_poses(walk, first_half, tmp_path):
    clouds = recorded_clouds(walk / "ros2_mcap")[HALF:]
    places = Places(first_half, read_tum(walk / "reference_tum.txt"))
    parameters = {
        "mode": "localization", "preset": "auto", "map_folder": str(first_half.folder), "process_every": "true",
    }  # fmt: skip
    with StreamBench(tmp_path, own_domain_id(111), parameters) as bench:
        own = [bench.decide(message) for message in clouds]
        bench.settle()
        poses = list(bench.answers.poses)
        assert bench.call(Trigger, "reset", Trigger.Request()).success
        health: list[DiagnosticArray] = []
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", health.append, 10)
        initial = bench.node.create_publisher(PoseWithCovarianceStamped, "/initialpose", QoSProfile(depth=10))
        assert spin_until(bench.executor, initial.get_subscription_count, PATIENCE_S)
        bench.decide(clouds[0])
        verdicts: dict[str, set[str]] = {name: set() for name in ERRORS}
        for k, message in enumerate(clouds[1:]):
            name = list(ERRORS)[k % len(ERRORS)]
            shift, yaw_deg = ERRORS[name]
            error = make_pose(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix(), shift)
            stamp_ns = ns_from_stamp(message.header.stamp)
            told = PoseWithCovarianceStamped(header=header(stamp_ns, "map"))
            told.pose.pose = plain_pose(places.at(stamp_ns) @ error)
            initial.publish(told)
            bench.status()
            before = len(bench.answers.decisions)
            bench.points.publish(message)
            assert bench.collector.wait_for_decisions(before + 2, PATIENCE_S)
            on_others, _ = bench.answers.decisions[before:]
            assert on_others["origin"] == "told"
            verdicts[name].add(on_others["verdict"])
        assert bench.status()["worker"]["told_wrong"]
        health.clear()
        assert spin_until(bench.executor, lambda: bool(health), PATIENCE_S)
        assert health[-1].status[-1].level == DiagnosticStatus.ERROR
    stamps = [ns_from_stamp(message.header.stamp) for message in clouds]
    found = [(ns, d["verdict"], d["origin"], d.get("probability")) for ns, d in zip(stamps, own, strict=True)]
    assert found == replayed(walk, first_half)
    assert verdicts == {name: {"accepted" if name == "true" else "rejected"} for name in ERRORS}
    assert len(poses) >= 0.9 * len(clouds)
    for message in poses:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        T = make_pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), (p.x, p.y, p.z))
        expected = places.at(ns_from_stamp(message.header.stamp))
        assert np.linalg.norm(T[:3, 3] - expected[:3, 3]) < 0.3
