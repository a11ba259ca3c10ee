"""Every topic that a decision goes out on."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from svc_ros.io.results import decision_values
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.localization_engine import TOLD
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.back_ends import EdgeOutput, edge_output
from svc_ros.ros.topics.conversions import (
    decision_message,
    place_message,
    pose_message,
    status_name,
    transform_message,
)
from svc_ros.ros.topics.frames import Frames, TransformOutput
from svc_ros.ros.topics.initial_pose import InitialPoseOutput
from svc_ros.ros.topics.looks import LookOutputs
from svc_ros.ros.topics.map_output import MapOutput
from svc_ros.ros.topics.odometry_outputs import OdometryOutputs
from svc_ros.ros.topics.paced_sender import PacedSender

_RELIABLE = QoSProfile(depth=100)
_LAST_DECISION = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
_AT_ONCE = Duration(seconds=0)  # rclpy waits with Python's lock in its hand: any longer, and all threads stand still


class Outputs:
    """Publishes decisions, for one thread at a time. What every pair has goes out on a thread of its own: see
    PacedSender.

    Raises MissingDependencyError for /tf without tf2_msgs, and for a back end whose messages are not installed.
    frames, is_active: see MapOutput.
    """

    def __init__(self, node: Node, settings: NodeSettings, frames: Frames, is_active: Callable[[], bool]) -> None:
        self._node, self._name = node, status_name(node)
        sends_scans = settings.publish_tf and not settings.sends_map_frame
        self._tf = TransformOutput(node, "publish_tf") if sends_scans else None
        self._map = MapOutput(node, settings, frames, is_active) if settings.sends_map_frame else None
        self._initial_pose = InitialPoseOutput(node) if settings.publish_initialpose else None
        self._edges: EdgeOutput | None = edge_output(node, settings.edges)
        self._decision = node.create_publisher(DiagnosticArray, "~/decision", _LAST_DECISION)
        self._rejected = node.create_publisher(Bool, "~/rejected", _RELIABLE)
        self._transform = node.create_publisher(TransformStamped, "~/transform", _RELIABLE)
        self._pose = node.create_publisher(PoseWithCovarianceStamped, "~/pose", _RELIABLE)
        self._looks = LookOutputs(node)
        self._odometry = OdometryOutputs(node, self._tf) if settings.mode == "scan_matching" else None
        # With depth 1 a decision replaces one that a reader has not got yet: of a burst of 1000 only 660 arrived.
        self._sender: PacedSender[tuple[Bool, DiagnosticArray]] = PacedSender(self._send, self._has_arrived)

    def publish(self, decision: Decision, settings: NodeSettings) -> None:
        """Send everything of one decision; the decision itself goes last, as the sign that the rest is out."""
        source, target = decision.source, decision.target
        if decision.result.accepted and decision.origin != TOLD and source is not None and target is not None:
            self._publish_pose(decision, source, target, settings)
        if self._map is not None:
            self._map.update(decision, settings)
        if self._initial_pose is not None:
            self._initial_pose.publish(decision, settings)
        if self._odometry is not None:
            self._odometry.publish(decision, settings)
        if self._edges is not None:
            self._edges.publish(decision)
        self._looks.publish(decision)
        self._sender.put((Bool(data=not decision.result.accepted), _message(decision, self._name)))

    def publish_path(self, settings: NodeSettings) -> None:
        """Send the way so far, in scan matching; from any thread."""
        if self._odometry is not None:
            self._odometry.publish_path(settings)

    def forget(self) -> None:
        """Tell nothing any more that follows from earlier decisions."""
        for part in (self._map, self._initial_pose):
            if part is not None:
                part.forget()

    def numbers(self) -> dict[str, Any]:
        """How `~/decision` gets along with its readers, and the map's frame with TF; safe from any thread."""
        sender = self._sender
        return {
            "waiting": sender.num_waiting,
            "unacknowledged": sender.num_unacknowledged,
            "reader_stopped": sender.is_reader_stopped,
            **(self._map.numbers() if self._map is not None else {}),
        }

    def finish(self, timeout_s: float) -> bool:
        """Send what waits; False if that was not possible in time. Nothing is published afterwards."""
        if self._map is not None:
            self._map.stop()
        return self._sender.close(timeout_s)

    def destroy(self) -> None:
        """Give all publishers back; `finish` comes first."""
        for publisher in (self._decision, self._rejected, self._transform, self._pose):
            self._node.destroy_publisher(publisher)
        for part in (self._looks, self._odometry, self._edges, self._map, self._initial_pose, self._tf):
            if part is not None:
                part.destroy()

    def _publish_pose(self, decision: Decision, source: CloudLabel, target: CloudLabel, settings: NodeSettings) -> None:
        T = decision.result.T_target_source
        assert T is not None
        message = transform_message(T, source.stamp_ns, target.frame_id, source.frame_id)
        self._transform.publish(message)
        if decision.place is None:
            self._pose.publish(pose_message(decision.result, source.stamp_ns, target.frame_id))
        else:
            self._pose.publish(place_message(decision.place, source.stamp_ns, settings.frame_of_map))
        if self._tf is not None and settings.mode == "pair":
            self._tf.publish(message, settings.tf_child_frame)

    # on the sender's thread

    def _send(self, message: tuple[Bool, DiagnosticArray]) -> None:
        rejected, decision = message
        try:
            self._rejected.publish(rejected)
            self._decision.publish(decision)
        except Exception:
            if self._node.context.ok():
                raise  # otherwise shut down meanwhile: nobody listens any more

    def _has_arrived(self) -> bool:
        return not self._node.context.ok() or self._decision.wait_for_all_acked(_AT_ONCE)


def _message(decision: Decision, node: str) -> DiagnosticArray:
    # A cloud without a partner: the message carries the stamp of the one there is.
    source, target = decision.source or decision.target, decision.target or decision.source
    stamp_ns, frame_id = (source.stamp_ns, target.frame_id) if source and target else (0, "")
    return decision_message(decision.result, _values(decision), stamp_ns, frame_id, node)


def _values(decision: Decision) -> dict[str, str]:
    """All that is known of a decision as flat text; the stamp and frame of a cloud that never came are empty."""
    result, source, target = decision.result, decision.source, decision.target
    values = decision_values(result, source.stamp_ns if source else 0, target.stamp_ns if target else 0)
    for side, label in (("source", source), ("target", target)):
        values[f"{side}_frame"] = label.frame_id if label else ""
        if label is None:
            values[f"{side}_stamp"] = ""
    for name, T in (("T_target_source", result.T_target_source), ("best_candidate", result.best_candidate)):
        values[name] = "" if T is None else json.dumps(T.tolist())
    if decision.origin:
        values["origin"] = decision.origin
    return values | {name: f"{value:.1f}" for name, value in decision.timings_ms.items()}
