"""Looks at the running system: who publishes clouds, in which frame, and what static transforms say."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from svc_ros.ros.collector import spin_until
from svc_ros.ros.discovery.choice import SeenTopic, cloud_topics
from svc_ros.ros.middleware import receiving_transports

_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_SETTLED_S = 1.0  # so long nothing new has come: what is there has been seen


class Onlooker:
    """A node of its own, between `with` and its end; it hears for at most `patience_s` for each question."""

    def __init__(self, patience_s: float = 3.0, domain_id: int | None = None) -> None:
        self._patience_s, self._domain_id = patience_s, domain_id
        self._context = Context()

    def __enter__(self) -> Onlooker:
        rclpy.init(args=[], context=self._context, domain_id=self._domain_id)
        with receiving_transports():  # a cloud is to be heard, too
            options = {"context": self._context, "enable_rosout": False, "start_parameter_services": False}
            self._node = Node("svc_onlooker", **options)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        return self

    def __exit__(self, *_exception: object) -> None:
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._context.try_shutdown()

    def clouds(self, wanted: Callable[[list[str]], bool]) -> list[str]:
        """Topics of clouds; waits until they are what is wanted, or, once there are any, unchanged for a second."""
        seen, changed_s, end_s = cloud_topics(self._seen()), time.monotonic(), time.monotonic() + self._patience_s
        while (now_s := time.monotonic()) < end_s and not wanted(seen):
            if seen and now_s > changed_s + _SETTLED_S:
                break
            time.sleep(0.05)
            latest = cloud_topics(self._seen())
            seen, changed_s = latest, (changed_s if latest == seen else now_s)
        return seen

    def frame_of(self, topic: str) -> str:
        """Frame of the next cloud of a topic; empty if none comes in time."""
        found: list[str] = []
        subscription = self._node.create_subscription(
            PointCloud2, topic, lambda cloud: found.append(cloud.header.frame_id), qos_profile_sensor_data
        )
        spin_until(self._executor, lambda: bool(found), self._patience_s)
        self._node.destroy_subscription(subscription)
        return found[0] if found else ""

    def static_parents(self, is_enough: Callable[[dict[str, str]], bool]) -> dict[str, str]:
        """Child to parent of the static transforms, as soon as they are enough; none where tf2_msgs is missing."""
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            return {}
        parents: dict[str, str] = {}

        def on_transforms(message: Any) -> None:
            parents.update({t.child_frame_id: t.header.frame_id for t in message.transforms})

        subscription = self._node.create_subscription(TFMessage, "/tf_static", on_transforms, _LATCHED)
        spin_until(self._executor, lambda: is_enough(parents), self._patience_s)
        self._node.destroy_subscription(subscription)
        return parents

    def _seen(self) -> list[SeenTopic]:
        names_and_types = self._node.get_topic_names_and_types()
        return [(name, types, self._node.count_publishers(name)) for name, types in names_and_types]
