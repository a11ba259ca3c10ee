"""Odometry, path and /tf of scan matching: what is sent of which scan, without a middleware."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import make_pose
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision, OdometryEstimate
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.conversions import odometry_message
from svc_ros.ros.topics.odometry_outputs import OdometryOutputs

pytestmark = pytest.mark.dds

SECOND = 1_000_000_000
SETTINGS = NodeSettings(mode="scan_matching", odom_frame="world")


class StandInNode:
    """Keeps what is published, by topic."""

    def __init__(self, num_subscribers: int = 1) -> None:
        self.sent, self._num_subscribers = {}, num_subscribers

    def create_publisher(self, _kind, topic, _qos):
        sent = self.sent.setdefault(topic, [])
        return SimpleNamespace(publish=sent.append, get_subscription_count=lambda: self._num_subscribers)


class StandInTf:
    def __init__(self) -> None:
        self.sent = []

    def publish(self, message, child_frame):
        self.sent.append((message, child_frame))


def scan(second: int, x: float, origin: str = "motion") -> Decision:
    pose = make_pose(np.eye(3), (x, 0.0, 0.0))
    result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", pose, pose)
    label = CloudLabel(second * SECOND, "lidar")
    return Decision(result, label, label, odometry=OdometryEstimate(pose, 0.01 * np.eye(6)), origin=origin)


def test_odometry_and_tf_lead_from_the_odometry_frame_to_the_cloud_or_the_base():
    for base_frame, child in (("", "lidar"), ("base_link", "base_link")):
        node, tf = StandInNode(), StandInTf()
        settings = NodeSettings(mode="scan_matching", odom_frame="world", base_frame=base_frame, tf_child_frame="body")
        OdometryOutputs(node, tf).publish(scan(3, 1.5), settings)
        (odometry,) = node.sent["~/odometry"]
        ((transform, asked_child),) = tf.sent
        for message in (odometry, transform):
            assert (message.header.frame_id, message.child_frame_id, message.header.stamp.sec) == ("world", child, 3)
        assert odometry.pose.pose.position.x == transform.transform.translation.x == 1.5
        assert asked_child == "body"


def test_a_scan_that_was_not_accepted_is_not_sent():
    node, tf = StandInNode(), StandInTf()
    result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP)
    outputs = OdometryOutputs(node, tf)
    outputs.publish(Decision(result, CloudLabel(1, "lidar"), CloudLabel(0, "lidar")), SETTINGS)
    outputs.publish_path(SETTINGS)
    assert not any(node.sent.values())
    assert tf.sent == []


def test_a_long_path_is_thinned_and_keeps_its_ends():
    node = StandInNode()
    outputs = OdometryOutputs(node, None)
    for k in range(5001):
        outputs.publish(scan(k, float(k), "start" if k == 0 else "motion"), SETTINGS)
    outputs.publish_path(SETTINGS)
    (path,) = node.sent["~/path"]
    stamps = [pose.header.stamp.sec for pose in path.poses]
    assert 500 <= len(stamps) <= 1001
    assert (stamps[0], stamps[-1]) == (0, 5000)
    assert np.all(np.diff(stamps[:-1]) == np.diff(stamps)[0])  # evenly, but for the last one
    assert path.header.frame_id == "world"


def test_the_path_is_sent_when_it_has_changed_and_somebody_listens():
    node, alone = StandInNode(), StandInNode(num_subscribers=0)
    for outputs in (OdometryOutputs(node, None), OdometryOutputs(alone, None)):
        outputs.publish(scan(0, 0.0, "start"), SETTINGS)
        outputs.publish_path(SETTINGS)
        outputs.publish_path(SETTINGS)
    assert len(node.sent["~/path"]) == 1
    assert alone.sent["~/path"] == []


def test_a_new_odometry_begins_a_new_path():
    node = StandInNode()
    outputs = OdometryOutputs(node, None)
    for k, origin in enumerate(("start", "motion", "motion", "start", "motion")):
        outputs.publish(scan(k, float(k), origin), SETTINGS)
    outputs.publish_path(SETTINGS)
    assert [pose.header.stamp.sec for pose in node.sent["~/path"][-1].poses] == [3, 4]


def test_an_uncertain_heading_far_from_the_origin_is_an_uncertain_position():
    covariance = np.diag([1e-4, 1e-4, 1e-4, 0.0, 0.0, 1e-4])  # left: a turn about the origin of 0.01 rad
    estimate = OdometryEstimate(make_pose(np.eye(3), (100.0, 0.0, 0.0)), covariance)
    told = odometry_message(estimate, 0, "odom", "lidar").pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(np.diag(told), [1e-4, 1e-4 + 1.0, 1e-4, 0.0, 0.0, 1e-4])
    assert told[1, 5] == pytest.approx(0.01)  # turned left, it stands farther left


def test_a_velocity_that_is_not_known_weighs_nothing_for_whoever_goes_by_its_covariance():
    told = odometry_message(OdometryEstimate(np.eye(4), 0.01 * np.eye(6)), 0, "odom", "lidar").twist
    assert (told.twist.linear.x, told.twist.angular.z) == (0.0, 0.0)
    assert told.covariance.reshape(6, 6).tolist() == (1e6 * np.eye(6)).tolist()
