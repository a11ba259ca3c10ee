"""Core types to messages and back, and the sensor's place by TF."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from geometry_msgs.msg import PoseWithCovarianceStamped
from ros_bench import matrix

from svc_ros.core.config import preset
from svc_ros.core.errors import InputError, MissingDependencyError, TransformUnavailableError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Scan
from svc_ros.core.se3 import make_pose
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.pipeline.decide import register_pair
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.topics import conversions
from svc_ros.ros.topics.frames import Frames, TransformOutput

T = make_pose([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [1.0, -2.0, 0.5])
STAMP = 1_700_000_000_123_456_789


def accepted(**extra):
    return RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", T_target_source=T, best_candidate=T, **extra)


def test_transform_has_target_as_parent_and_source_as_child():
    message = conversions.transform_message(T, STAMP, "map", "lidar")
    assert (message.header.frame_id, message.child_frame_id) == ("map", "lidar")
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP
    assert np.allclose(matrix(message), T)


def test_pose_carries_the_covariance_row_by_row():
    covariance = np.diag(np.arange(1.0, 7.0))
    covariance[0, 5] = covariance[5, 0] = 0.25
    message = conversions.pose_message(accepted(covariance=covariance), STAMP, "map")
    assert message.pose.covariance.reshape(6, 6).tolist() == covariance.tolist()
    assert np.allclose(conversions.pose_from_message(message), T)


def test_pose_without_covariance_is_never_certain():
    message = conversions.pose_message(accepted(), STAMP, "map")
    assert (np.diag(message.pose.covariance.reshape(6, 6)) > 0.01).all()


def test_pose_of_a_rejected_result_is_refused():
    with pytest.raises(InputError, match="rejected"):
        conversions.pose_message(RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP), STAMP, "map")


@pytest.mark.parametrize(("field", "value"), [("w", 0.0), ("x", float("nan"))])
def test_guess_without_a_rotation_is_refused(field, value):
    message = PoseWithCovarianceStamped()
    setattr(message.pose.pose.orientation, field, value)
    with pytest.raises(InputError, match="pose: expected"):
        conversions.pose_from_message(message)


def test_cloud_is_read_back_as_it_was():
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32) + 3
    reading = scan_from_cloud(conversions.cloud_message(points, STAMP, "lidar", {"ring": np.arange(50)}))
    assert (reading.scan.stamp_ns, reading.scan.frame_id) == (STAMP, "lidar")
    assert np.array_equal(reading.scan.points, points)


@pytest.mark.parametrize(
    ("result", "level", "message"),
    [
        (accepted(), b"\x00", "accepted: ok"),
        (RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP), b"\x01", "rejected: low_overlap"),
        (RegistrationResult(Verdict.UNDECIDED, Reason.AMBIGUOUS), b"\x01", "undecided: ambiguous"),
        (RegistrationResult(Verdict.DROPPED, Reason.TIME_SKEW), b"\x01", "dropped: time_skew"),
        (
            RegistrationResult(Verdict.REJECTED, Reason.INTERNAL_ERROR, detail="x"),
            b"\x02",
            "rejected: internal_error (x)",
        ),
        (RegistrationResult(Verdict.REJECTED, Reason.TF_UNAVAILABLE), b"\x02", "rejected: tf_unavailable"),
    ],
)
def test_decision_is_ok_warn_or_error(result, level, message):
    array = conversions.decision_message(result, {"verdict": result.verdict.value}, STAMP, "map")
    (status,) = array.status
    assert (status.level, status.message) == (level, message)
    assert [(kv.key, kv.value) for kv in status.values] == [("verdict", result.verdict.value)]


def test_the_hint_at_another_unit_reaches_the_message():
    """What the node does with two clouds: the pair's result becomes the status."""
    scan = Scan(1000.0 * np.random.default_rng(0).normal(size=(500, 3)) * 8.0)
    result = register_pair(scan, scan, preset("lidar_outdoor"))
    (status,) = conversions.decision_message(result, {}, STAMP, "map").status
    assert status.message.startswith("rejected: too_few_points (")
    assert "millimetres?" in status.message


def test_sensor_in_the_cloud_frame_needs_no_tf():
    settings = NodeSettings(sensor_origin=(0.0, 0.0, 1.7))
    assert Frames(None, settings).sensor_origin(settings, "base_link", STAMP).tolist() == [0.0, 0.0, 1.7]


def test_sensor_frame_without_tf2_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    with pytest.raises(MissingDependencyError, match=r"ros-jazzy-tf2-ros-py.*sensor_origin"):
        Frames(None, NodeSettings(sensor_frame="lidar"))


@pytest.fixture
def buffer(monkeypatch):
    """A stand-in for tf2_ros, with the two names that are used and the transforms of a dict."""
    known = {("base_link", "lidar"): (0.1, 0.2, 1.5)}

    class Buffer:
        def lookup_transform(self, target, source, time, timeout):
            if (target, source) not in known:
                raise LookupError("not in the tree")
            x, y, z = known[target, source]
            turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
            return SimpleNamespace(transform=SimpleNamespace(translation=SimpleNamespace(x=x, y=y, z=z), rotation=turn))

    module = ModuleType("tf2_ros")
    module.Buffer, module.TransformListener = Buffer, lambda buffer, node: object()
    monkeypatch.setitem(sys.modules, "tf2_ros", module)


@pytest.mark.usefixtures("buffer")
def test_sensor_origin_by_tf():
    settings = NodeSettings(sensor_frame="lidar")
    assert Frames(None, settings).sensor_origin(settings, "base_link", STAMP).tolist() == [0.1, 0.2, 1.5]


@pytest.mark.usefixtures("buffer")
def test_missing_transform_names_both_frames():
    settings = NodeSettings(sensor_frame="lidar")
    with pytest.raises(TransformUnavailableError, match=r"'lidar' to 'odom' at 1700000000\.123456789 s: not in the"):
        Frames(None, settings).sensor_origin(settings, "odom", STAMP)


def test_publish_tf_without_tf2_msgs_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs", None)
    with pytest.raises(MissingDependencyError, match="ros-jazzy-tf2-msgs"):
        TransformOutput(None, "publish_tf")


@pytest.mark.parametrize(
    ("source_frame", "child_frame", "child"), [("lidar", "", "lidar/source"), ("b", "", "b"), ("lidar", "body", "body")]
)
def test_transform_on_tf_never_has_one_frame_twice(monkeypatch, source_frame, child_frame, child):
    sent = []
    module = ModuleType("tf2_msgs.msg")
    module.TFMessage = lambda transforms: transforms
    monkeypatch.setitem(sys.modules, "tf2_msgs", ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", module)
    node = SimpleNamespace(create_publisher=lambda *_args: SimpleNamespace(publish=sent.extend))
    message = conversions.transform_message(T, STAMP, "lidar", source_frame)
    TransformOutput(node, "publish_tf").publish(message, child_frame)
    (message,) = sent
    assert (message.header.frame_id, message.child_frame_id) == ("lidar", child)
    assert np.allclose(matrix(message), T)
