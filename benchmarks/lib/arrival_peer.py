"""One end of a topic with big clouds, best effort: `send TOPICS POINTS RATE_HZ COUNT` or `receive TOPICS SECONDS`.

TOPICS with commas between. Each prints as its last line what it has sent or received.
"""

from __future__ import annotations

import os
import sys
import time
from array import array
from collections import Counter

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from lib.live_driver import wait_until_heard
from svc_ros.ros.middleware import receiving_transports

_POINT_STEP, _DRAINED_S = 16, 1.0


def send(topics: str, points: int, rate_hz: float, count: int) -> None:
    """Publish `count` clouds on each topic, at that rate."""
    rclpy.init()
    node = rclpy.create_node("driver")
    publishers = [node.create_publisher(PointCloud2, topic, qos_profile_sensor_data) for topic in topics.split(",")]
    message = PointCloud2(height=1, width=points, point_step=_POINT_STEP, row_step=_POINT_STEP * points)
    message.data = array("B", os.urandom(_POINT_STEP * points))
    wait_until_heard(*publishers)
    start = time.monotonic()
    for number in range(count):
        for publisher in publishers:
            publisher.publish(message)
        time.sleep(max(0.0, start + (number + 1) / rate_hz - time.monotonic()))
    time.sleep(_DRAINED_S)
    print(f"sent {count * len(publishers)}", flush=True)
    os._exit(0)


def receive(topics: str, seconds: float, as_the_node: bool) -> None:
    """Take what comes until the time is over. as_the_node: with the transports that the node gives itself."""
    rclpy.init()
    if as_the_node:
        with receiving_transports():
            node = rclpy.create_node("receiver")
    else:
        node = rclpy.create_node("receiver")
    received: Counter[str] = Counter()
    for topic in topics.split(","):
        node.create_subscription(
            PointCloud2, topic, lambda _, topic=topic: received.update([topic]), qos_profile_sensor_data
        )
    executor, end = SingleThreadedExecutor(), time.monotonic() + seconds
    executor.add_node(node)
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    print(f"received {received.total()}", flush=True)
    os._exit(0)


if __name__ == "__main__":
    role, *words = sys.argv[1:]
    if role == "send":
        send(words[0], int(words[1]), float(words[2]), int(words[3]))
    else:
        receive(words[0], float(words[1]), role == "receive_as_the_node")
