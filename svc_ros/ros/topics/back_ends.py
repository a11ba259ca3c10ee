"""Loops for pose-graph back ends, in the messages of their own packages. The one place that may import those.

`pose_graph_tools`: every judged candidate between keyframes as a PoseGraphEdge on `~/edges`. `rtabmap`: every accepted
loop as a user link through rtabmap's service `add_link`; rtabmap's numbers of the scans are learned from its `info`.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any, Protocol

import numpy as np
from geometry_msgs.msg import Transform, Vector3
from rclpy.node import Node
from rclpy.qos import QoSProfile

from svc_ros.core.errors import MissingDependencyError
from svc_ros.io.results import UNKNOWN_COVARIANCE
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.topics.conversions import header, plain_pose

_NEEDS = "edges:={} needs {} ({})"
_LOOP, _REJECTED_LOOP = 1, 3  # types of a PoseGraphEdge
_USER_CLOSURE = 4  # type of an rtabmap link
_KEPT_NODES = 10_000
_MAX_SKEW_NS = 1_000_000  # rtabmap keeps stamps in float64 seconds


class EdgeOutput(Protocol):
    """Where judged loops go."""

    def publish(self, decision: Decision) -> None:
        """Send one decision, if it is about a loop."""
        ...

    def destroy(self) -> None:
        """Give everything back."""
        ...


def edge_output(node: Node, edges: str) -> EdgeOutput | None:
    """The output that the parameter `edges` names; MissingDependencyError without its package."""
    if edges == "pose_graph_tools":
        return PoseGraphToolsEdges(node)
    return RtabmapLinks(node) if edges == "rtabmap" else None


class PoseGraphToolsEdges:
    """`~/edges`: accepted loops as type 1, those that were not accepted as type 3, keys as in the g2o file."""

    def __init__(self, node: Node) -> None:
        try:
            from pose_graph_tools_msgs.msg import PoseGraphEdge
        except ImportError:
            package = "pose_graph_tools_msgs"
            how = "build it in the workspace: github.com/MIT-SPARK/pose_graph_tools"
            raise MissingDependencyError(_NEEDS.format("pose_graph_tools", package, how)) from None
        self._node, self._message_type = node, PoseGraphEdge
        self._publisher = node.create_publisher(PoseGraphEdge, "~/edges", QoSProfile(depth=100))

    def publish(self, decision: Decision) -> None:
        """Send the edge from target to source, with the candidate pose where it was not accepted."""
        result = decision.result
        if decision.vertices is None or decision.source is None or result.best_candidate is None:
            return
        source, target = decision.vertices
        T = result.best_candidate if result.T_target_source is None else result.T_target_source
        message = self._message_type(
            header=header(decision.source.stamp_ns, decision.source.frame_id), key_from=target, key_to=source,
            type=_LOOP if result.accepted else _REJECTED_LOOP, pose=plain_pose(T),
        )  # fmt: skip
        covariance = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
        message.covariance = np.asarray(covariance, np.float64).reshape(-1)
        self._publisher.publish(message)

    def destroy(self) -> None:
        """Give the publisher back."""
        self._node.destroy_publisher(self._publisher)


class RtabmapLinks:
    """Calls `rtabmap/add_link` for accepted loops; it knows the scans' numbers from `rtabmap/info`, by their stamps.

    The clouds must be in the frame that rtabmap maps (its `frame_id`). A loop that rtabmap has no node for is said in
    the log and left out.
    """

    def __init__(self, node: Node) -> None:
        try:
            from rtabmap_msgs.msg import Info, Link
            from rtabmap_msgs.srv import AddLink
        except ImportError:
            how = "apt install ros-jazzy-rtabmap-msgs"
            raise MissingDependencyError(_NEEDS.format("rtabmap", "rtabmap_msgs", how)) from None
        self._node, self._link_type, self._request_type = node, Link, AddLink.Request
        self._nodes: OrderedDict[int, int] = OrderedDict()
        self._subscription = node.create_subscription(Info, "rtabmap/info", self._on_info, QoSProfile(depth=100))
        self._client = node.create_client(AddLink, "rtabmap/add_link")

    def publish(self, decision: Decision) -> None:
        """Ask rtabmap to add an accepted loop."""
        result, source, target = decision.result, decision.source, decision.target
        if result.T_target_source is None or source is None or target is None:
            return
        ends = self._number(target.stamp_ns), self._number(source.stamp_ns)
        if None in ends or ends[0] == ends[1] or not self._client.service_is_ready():
            stamps = f"{text_from_ns(target.stamp_ns)} s and {text_from_ns(source.stamp_ns)} s"
            self._node.get_logger().warning(f"rtabmap has no nodes for the loop between {stamps}, or does not answer")
            return
        link = self._link_type(from_id=ends[0], to_id=ends[1], type=_USER_CLOSURE)
        pose = plain_pose(result.T_target_source)
        p = pose.position
        link.transform = Transform(translation=Vector3(x=p.x, y=p.y, z=p.z), rotation=pose.orientation)
        covariance = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
        link.information = np.linalg.inv(np.asarray(covariance, np.float64)).reshape(-1)
        self._client.call_async(self._request_type(link=link))

    def destroy(self) -> None:
        """Give subscription and client back."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_client(self._client)

    def _on_info(self, message: Any) -> None:
        self._nodes[ns_from_stamp(message.header.stamp)] = int(message.ref_id)
        while len(self._nodes) > _KEPT_NODES:
            self._nodes.popitem(last=False)

    def _number(self, stamp_ns: int) -> int | None:
        """rtabmap's number of the scan with this stamp."""
        nodes = list(self._nodes.items())
        skew, number = min(((abs(stamp - stamp_ns), number) for stamp, number in nodes), default=(_MAX_SKEW_NS + 1, -1))
        return number if skew <= _MAX_SKEW_NS else None
