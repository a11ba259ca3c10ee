"""Listens to a topic with clouds, and takes down what came, who sends it and who else listens.

Messages are taken as bytes, of which only stamp, frame and size are read: whoever converts each cloud loses some, and
would take that for a fault of the network.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import PointCloud2

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.cdr import CdrReader
from svc_ros.io.clouds.livox import CLOUD_TYPES, LIVOX_TYPE, cloud_from_cdr
from svc_ros.io.heard import Arrival, Endpoint, Heard
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.ros.middleware import cure
from svc_ros.ros.topics.cloud_topic import livox_class, node_of, type_to_take

_DISCOVERY_S = 5.0  # until a topic without publisher is believed to have none
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's word for it
_LOOK_S = 0.05
_DEPTH = 100  # so that what is missing was lost before it came here
_NUM_LOOKS = 10  # moments, evenly spread, of which two clouds in a row are kept


class Ear:
    """Takes down every message on `topic`; of two in a row, at some moments within `seconds`, it keeps the bytes."""

    def __init__(self, node: Node, topic: str, kind: str, seconds: float, depth: int = _DEPTH) -> None:
        self.arrivals: list[Arrival] = []
        self.kept: dict[int, bytes] = {}
        self.num_lost = 0
        self._clock, self._is_livox = node.get_clock(), kind == LIVOX_TYPE
        self._start, self._step_s = time.monotonic(), seconds / _NUM_LOOKS
        self._num_looks, self._keeps_next = 0, False
        node.create_subscription(
            livox_class() if self._is_livox else PointCloud2, topic, self._on_message,
            QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT), raw=True,
            event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost),
        )  # fmt: skip

    def _on_message(self, data: bytes, info: dict[str, Any]) -> None:
        stamp_ns, frame_id, num_points = _summary(data, self._is_livox)
        if self._is_due():
            self.kept[len(self.arrivals)] = data
        came_ns = int(info["received_timestamp"]) or time.time_ns()
        clock_ns = self._clock.now().nanoseconds if self._clock.ros_time_is_active else 0
        sequence = info["publication_sequence_number"]
        self.arrivals.append(
            Arrival(came_ns, stamp_ns, frame_id, num_points, len(data), sequence or None, clock_ns or None)
        )

    def _is_due(self) -> bool:
        if self._keeps_next:
            self._keeps_next = False
            return True
        num_due = 1 + int((time.monotonic() - self._start) / self._step_s)
        self._keeps_next = num_due > self._num_looks
        self._num_looks = max(num_due, self._num_looks)
        return self._keeps_next

    def _on_lost(self, info: Any) -> None:
        self.num_lost = info.total_count


def listen(node: Node, topic: str, seconds: float) -> Heard:
    """What is heard on a topic in so many seconds; of a topic without clouds, who publishes there and what else is.

    Raises InputError for a name that no topic can have.
    """
    topic = _resolved(node, topic)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + _DISCOVERY_S
    while not _are_known(publishers := _publishers(node, topic)) and time.monotonic() < end:
        executor.spin_once(timeout_sec=_LOOK_S)
    kind = type_to_listen_to({publisher.type for publisher in publishers})
    if not kind:
        return Heard(topic, seconds, publishers=publishers, **_surroundings(node))
    if node.count_publishers("/clock"):
        node.set_parameters([Parameter("use_sim_time", value=True)])
    ear = Ear(node, topic, kind, seconds)
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        executor.spin_once(timeout_sec=left)
    executor.shutdown()
    return Heard(
        topic, seconds, kind, _publishers(node, topic) or publishers, _other_subscriptions(node, topic),
        tuple(ear.arrivals), ear.num_lost, kept=ear.kept, **_surroundings(node),
    )  # fmt: skip


def type_to_listen_to(sent: set[str]) -> str:
    """The type of the clouds among those that are sent; empty where there is none that can be taken."""
    kind = type_to_take(sent, "", LIVOX_TYPE in sent and livox_class() is not None)
    return kind if kind in sent else ""


def _summary(data: bytes, is_livox: bool) -> tuple[int, str, int]:
    """Stamp [ns], frame and number of points."""
    if is_livox:
        cloud = cloud_from_cdr(data)
        return ns_from_stamp(cloud.header.stamp), cloud.header.frame_id, cloud.width
    reader = CdrReader(data)
    header = reader.header()
    return ns_from_stamp(header.stamp), header.frame_id, reader.value("I") * reader.value("I")


def _resolved(node: Node, topic: str) -> str:
    try:
        return str(node.resolve_topic_name(topic))
    except RCLError as error:
        raise InputError(str(error).partition(", at ")[0]) from None


def _publishers(node: Node, topic: str) -> tuple[Endpoint, ...]:
    return _endpoints(node.get_publishers_info_by_topic(topic))


def _are_known(publishers: Sequence[Endpoint]) -> bool:
    """Whether there are some, each with its node; the name of a node may come later than its publisher."""
    return bool(publishers) and not any(publisher.node.endswith(_UNKNOWN) for publisher in publishers)


def _other_subscriptions(node: Node, topic: str) -> tuple[Endpoint, ...]:
    found = _endpoints(node.get_subscriptions_info_by_topic(topic))
    return tuple(endpoint for endpoint in found if endpoint.node != node.get_fully_qualified_name())


def _endpoints(found: Sequence[TopicEndpointInfo]) -> tuple[Endpoint, ...]:
    return tuple(
        Endpoint(
            node_of(info), info.topic_type,
            _words(info.qos_profile.reliability), _words(info.qos_profile.durability), info.qos_profile.depth,
        )
        for info in found
    )  # fmt: skip


def _words(policy: Any) -> str:
    return str(policy.name).lower().replace("_", " ")


def _surroundings(node: Node) -> dict[str, Any]:
    """What else is to be seen from here, and what to do against loss."""
    clouds = [name for name, kinds in node.get_topic_names_and_types() if CLOUD_TYPES & set(kinds)]
    nodes = {name for name, _ in node.get_node_names_and_namespaces() if not name.startswith("_")}
    discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    return {
        "cloud_topics": tuple(sorted(name for name in clouds if node.count_publishers(name))),
        "num_nodes": len(nodes - {node.get_name()}),
        "where": (
            f"ROS_DOMAIN_ID {node.context.get_domain_id()}, ROS_AUTOMATIC_DISCOVERY_RANGE {discovery}, "
            f"{rclpy.get_rmw_implementation_identifier()}"
        ),
        "cure": cure(),
    }
