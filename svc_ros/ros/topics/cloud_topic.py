"""One cloud input, subscribed to as what its publishers send: PointCloud2, or Livox' own message.

A participant can read a topic as one type only, and a driver may start after the node. So the node looks who publishes,
at the start and now and then, and subscribes anew where clouds come as the other type.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import NoTypeSupportImportedException
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.type_support import check_for_type_support
from sensor_msgs.msg import PointCloud2

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.livox import LIVOX_TYPE, NO_LIVOX_PACKAGE, cloud_from_cdr
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE


@dataclass(frozen=True)
class CloudSource:
    """What to subscribe to. is_raw: `callback` takes the bytes of a message instead of an object."""

    message_class: Any
    callback: Callable[[Any], None]
    is_raw: bool = False


class CloudTopic:
    """Keeps the subscription to `topic`, a name that may be remapped.

    subscribe: makes it; take: is given each cloud, a PointCloud2 or what has its attributes; problems: by topic, what
    its publishers send and the node cannot take, for diagnostics.
    """

    def __init__(
        self, node: Node, topic: str, subscribe: Callable[[CloudSource], Subscription], take: Callable[[Any], None],
        problems: dict[str, str],
    ) -> None:  # fmt: skip
        self._node, self._topic, self._resolved = node, topic, node.resolve_topic_name(topic)
        self._subscribe, self._take, self._problems = subscribe, take, problems
        self._subscription: Subscription | None = None
        self._type, self._has_failed, self._is_destroyed = "", False, False
        self._lock = threading.Lock()  # the session may end on another thread while this one looks
        self.look()

    def look(self) -> None:
        """See who publishes; subscribe anew where that is needed, and say in the log what cannot be taken."""
        with self._lock:
            if self._is_destroyed:
                return
            senders = self._senders()
            livox = livox_class() if LIVOX_TYPE in senders else None
            wanted = type_to_take(senders, self._type or CLOUD_TYPE, livox is not None)
            problem = self._change(wanted, livox) if wanted != self._type else ""
            problem = problem or type_problem(self._resolved, senders, wanted)
            if problem and problem != self._problems.get(self._topic):
                self._node.get_logger().error(problem)
            if problem:
                self._problems[self._topic] = problem
            else:
                self._problems.pop(self._topic, None)

    def destroy(self) -> None:
        """Give the subscription back, for good."""
        with self._lock:
            self._is_destroyed = True
            self._give_back()

    def _senders(self) -> dict[str, str]:
        """Types that are published on the topic, and the nodes that do so."""
        nodes: dict[str, list[str]] = {}
        for info in self._node.get_publishers_info_by_topic(self._topic):
            nodes.setdefault(info.topic_type, []).append(node_of(info))
        return {kind: ", ".join(dict.fromkeys(names)) for kind, names in nodes.items()}

    def _change(self, wanted: str, livox: Any) -> str:
        """Subscribe as another type; what is in the way of it for longer than a moment, or an empty text."""
        is_first = not self._type
        self._give_back()
        is_livox = wanted == LIVOX_TYPE
        source = CloudSource(livox, self._take_livox, True) if is_livox else CloudSource(PointCloud2, self._take)
        try:
            self._subscription = self._subscribe(source)
        except RCLError as error:  # another thread may still wait for the last one: the next look tries again
            is_lasting, self._has_failed = self._has_failed, True
            why = f"does another node of this process read it as another type? ({error})"
            return f"{self._resolved}: cannot be subscribed to as {wanted}: {why}" if is_lasting else ""
        self._has_failed = False
        if is_livox or not is_first:
            self._node.get_logger().info(f"{self._resolved}: clouds are taken as {wanted}")
        self._type = wanted
        return ""

    def _give_back(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._type, self._subscription = "", None

    def _take_livox(self, data: bytes) -> None:
        try:
            cloud = cloud_from_cdr(data)
        except UnsupportedCloudError as error:
            self._node.get_logger().warning(f"{self._resolved}: {error}", throttle_duration_sec=5.0)
            return
        self._take(cloud)


def type_to_take(sent: Collection[str], current: str, has_livox: bool) -> str:
    """The type to subscribe to, by the types that are sent; PointCloud2 before Livox' own, `current` if neither is."""
    if CLOUD_TYPE in sent:
        return CLOUD_TYPE
    return LIVOX_TYPE if LIVOX_TYPE in sent and has_livox else current


def type_problem(topic: str, senders: Mapping[str, str], taken: str) -> str:
    """One line for a type that is sent and not taken, with what to do; empty where there is none."""
    for kind, nodes in senders.items():
        if kind == taken:
            continue
        advice = f"expected {taken}"
        if taken in senders:
            advice = f"a topic has one type, here {taken}: give each publisher a topic of its own"
        elif kind == LIVOX_TYPE:
            advice = NO_LIVOX_PACKAGE
        return f"{topic}: {nodes} publishes {kind}, which is not taken: {advice}"
    return ""


def node_of(endpoint: TopicEndpointInfo) -> str:
    """Name of the node, with its namespace, that a publisher or a subscription belongs to."""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def livox_class() -> Any:
    """Livox' message class, None where its package is not installed or does not work here."""
    package, _, name = LIVOX_TYPE.split("/")
    try:
        message_class = getattr(importlib.import_module(f"{package}.msg"), name)
        check_for_type_support(message_class)
    except (ImportError, AttributeError, NoTypeSupportImportedException):
        return None
    return message_class
