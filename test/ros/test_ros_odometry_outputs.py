"""Odometry, path and /tf of scan matching: what is sent of which scan, without a middleware."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from ros_bench import matrix
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import ConfigError
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


def scan(second: int, where: float | np.ndarray, origin: str = "motion") -> Decision:
    """Accepted, at a pose or so far along x."""
    pose = where if isinstance(where, np.ndarray) else make_pose(np.eye(3), (where, 0.0, 0.0))
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


def test_turned_round_the_odometry_frame_is_the_child_of_the_robot():
    node, tf = StandInNode(), StandInTf()
    settings = NodeSettings(mode="scan_matching", odom_frame="odom_lidar", base_frame="base_link", invert_odom_tf=True)
    turned = make_pose(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (2.0, 0.0, 0.0))
    OdometryOutputs(node, tf).publish(scan(3, turned), settings)
    ((transform, asked_child),) = tf.sent
    assert (transform.header.frame_id, transform.child_frame_id, asked_child) == ("base_link", "odom_lidar", "")
    np.testing.assert_allclose(matrix(transform) @ turned, np.eye(4), atol=1e-12)
    (odometry,) = node.sent["~/odometry"]  # which stays as it is
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom_lidar", "base_link")
    assert odometry.pose.pose.position.x == 2.0


@pytest.mark.parametrize(
    ("wanted", "position", "orientation", "speed", "rate", "together"),
    [
        ({}, 0.04, 0.01, 0.09, 0.02, 0.005),
        ({"position_covariance": 0.5}, 0.5, 0.01, 0.09, 0.02, 0.0),
        ({"position_covariance": 0.5, "orientation_covariance": 0.2}, 0.5, 0.2, 0.09, 0.02, 0.0),
        ({"linear_velocity_covariance": 0.3, "angular_velocity_covariance": 0.1}, 0.04, 0.01, 0.3, 0.1, 0.005),
    ],
)
def test_covariances_that_are_set_are_told_in_place_of_the_computed_ones(
    wanted, position, orientation, speed, rate, together
):
    pose = np.diag([0.04] * 3 + [0.01] * 3)
    pose[1, 5] = pose[5, 1] = 0.005
    estimate = OdometryEstimate(np.eye(4), pose, np.ones(6), np.diag([0.09] * 3 + [0.02] * 3))
    node, settings = StandInNode(), NodeSettings(mode="scan_matching", **wanted)
    OdometryOutputs(node, None).publish(dataclasses.replace(scan(3, 0.0), odometry=estimate), settings)
    (message,) = node.sent["~/odometry"]
    told = message.pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(np.diag(told), [position] * 3 + [orientation] * 3)
    assert told[1, 5] == told[5, 1] == together
    np.testing.assert_allclose(np.diag(message.twist.covariance.reshape(6, 6)), [speed] * 3 + [rate] * 3)


def test_a_velocity_that_is_not_known_stays_unknown_whatever_is_set():
    told = []
    for wanted in ({}, {"linear_velocity_covariance": 0.01, "angular_velocity_covariance": 0.01}):
        node = StandInNode()
        OdometryOutputs(node, None).publish(scan(0, 0.0, "start"), NodeSettings(mode="scan_matching", **wanted))
        told.append(node.sent["~/odometry"][0].twist.covariance.tolist())
    assert told[0] == told[1]


@pytest.mark.parametrize(
    ("wanted", "named"),
    [
        ({"mode": "pair", "invert_odom_tf": True}, "invert_odom_tf belongs to mode scan_matching"),
        ({"mode": "loop_closure", "position_covariance": 0.1}, "position_covariance belongs to mode scan_matching"),
        ({"mode": "scan_matching", "invert_odom_tf": True, "tf_child_frame": "x"}, "invert_odom_tf and tf_child_frame"),
    ],
)
def test_what_does_not_go_together_is_refused_by_name(wanted, named):
    with pytest.raises(ConfigError, match=named):
        NodeSettings(**wanted)


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
