"""`initialpose` for others: where they are, told to who is lost, and only by who is sure."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from svc_ros.core.result import Verdict
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.localization_engine import TOLD, TOLD_FOR_NS
from svc_ros.ros.topics.conversions import place_message

_IN_A_ROW = 3


class InitialPoseGuard:
    """Says when a place may be told: when three scans in a row knew it, while three poses in a row that others told
    were rejected, or nobody has told one for five seconds. Then not again before others were right once, or the place
    was lost and found.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """As at the start."""
        self._told_ns: int | None = None  # when others told something last, or else of the first scan
        self._num_sure, self._num_wrong, self._may_tell = 0, 0, True

    def allows(self, decision: Decision) -> bool:
        """Take the next decision; True if the place that it has is to be told."""
        stamp_ns = 0 if decision.source is None else decision.source.stamp_ns
        if self._told_ns is None or decision.origin == TOLD or stamp_ns < self._told_ns:
            self._told_ns = stamp_ns
        if decision.origin == TOLD:
            verdict = decision.result.verdict
            self._num_wrong = self._num_wrong + 1 if verdict is Verdict.REJECTED else 0
            self._may_tell = self._may_tell or verdict is Verdict.ACCEPTED
            return False
        self._may_tell = self._may_tell or (decision.place is not None and decision.place.T_map_odom is None)
        if not decision.result.accepted or decision.place is None:
            self._num_sure = self._num_wrong = 0
            return False
        self._num_sure += 1
        is_wrong, is_silent = self._num_wrong >= _IN_A_ROW, stamp_ns - self._told_ns >= TOLD_FOR_NS
        is_allowed = self._may_tell and self._num_sure >= _IN_A_ROW and (is_wrong or is_silent)
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
