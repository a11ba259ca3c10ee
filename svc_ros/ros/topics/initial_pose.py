"""`initialpose` for others: where they are, told to who is lost, and only by who is sure."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from svc_ros.core.result import Verdict
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.localization_engine import TOLD
from svc_ros.ros.topics.conversions import place_message

_SCANS = 3  # in a row that know their place while nobody tells it rightly


class InitialPoseGuard:
    """Says when a place may be told: in the third scan in a row whose own place is accepted while what others tell is
    rejected, or they tell nothing. Then not again before they were right once, or the place was lost and found.
    """

    def __init__(self) -> None:
        self._told: Verdict | None = None
        self._num_sure, self._may_tell = 0, True

    def forget(self) -> None:
        """As at the start."""
        self._told, self._num_sure, self._may_tell = None, 0, True

    def allows(self, decision: Decision) -> bool:
        """Take the next decision; True if the place that it has is to be told."""
        if decision.origin == TOLD:
            self._told = decision.result.verdict
            return False
        told, self._told = self._told, None
        is_lost = decision.place is not None and decision.place.T_map_odom is None
        self._may_tell = self._may_tell or is_lost or told is Verdict.ACCEPTED
        is_sure = decision.result.accepted and decision.place is not None and told in (None, Verdict.REJECTED)
        self._num_sure = self._num_sure + 1 if is_sure else 0
        is_allowed = self._may_tell and self._num_sure >= _SCANS
        self._may_tell = self._may_tell and not is_allowed
        return is_allowed


class InitialPoseOutput:
    """Publishes `initialpose` as the guard allows it, for one thread at a time."""

    def __init__(self, node: Node) -> None:
        self._node, self._guard = node, InitialPoseGuard()
        self._publisher = node.create_publisher(PoseWithCovarianceStamped, "initialpose", QoSProfile(depth=10))

    def publish(self, decision: Decision, settings: NodeSettings) -> None:
        """Take the next decision, and tell the place that it has if that is allowed."""
        if self._guard.allows(decision) and decision.place is not None and decision.source is not None:
            self._publisher.publish(place_message(decision.place, decision.source.stamp_ns, settings.frame_of_map))
            self._node.get_logger().info(
                "initialpose: told where the robot is, since nobody else does or they are wrong"
            )

    def forget(self) -> None:
        """Tell nothing that follows from earlier decisions."""
        self._guard.forget()

    def destroy(self) -> None:
        """Give the publisher back."""
        self._node.destroy_publisher(self._publisher)
