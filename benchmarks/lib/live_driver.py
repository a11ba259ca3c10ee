"""A driver as they are: publishes a bag's clouds at a rate, best effort, and knows nothing of the node.

    python -m lib.live_driver BAG TOPIC RATE_HZ SECONDS

There and back through the bag, with stamps that go on at that rate. On its last line it says how many it has sent.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import cycle

import rclpy
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from svc_ros.io.bags import Bag
from svc_ros.ros.bag_player import ros_cloud
from svc_ros.ros.topics.conversions import header

START_NS = 1_000_000_000
_HEARD_S, _DISCOVERED_S = 120.0, 1.0


def order_of(count: int) -> Iterator[int]:
    """Numbers of the scans as they are played: 0 1 2 1 0 1 ... for three."""
    return cycle([*range(count), *range(count - 2, 0, -1)])


def stamp_of(number: int, rate_hz: float) -> int:
    """The stamp [ns] of what is played at this place."""
    return START_NS + round(1e9 * number / rate_hz)


def wait_until_heard(*publishers: Publisher) -> None:
    """Return when somebody listens to each of them, or gives no sign for a minute or two."""
    end = time.monotonic() + _HEARD_S
    while not all(publisher.get_subscription_count() for publisher in publishers) and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(_DISCOVERED_S)  # the other side learns of this one a little later


def main(bag_path: str, topic: str, rate_hz: float, seconds: float) -> None:
    """Play until the time is over."""
    with Bag(bag_path) as bag:
        clouds = [ros_cloud(message) for _, message in bag.raw_clouds(bag.resolve_cloud_topic(None))]
    rclpy.init()
    node = rclpy.create_node("driver")
    publisher = node.create_publisher(PointCloud2, topic, qos_profile_sensor_data)
    wait_until_heard(publisher)
    start, count = time.monotonic(), round(rate_hz * seconds)
    for number, index in zip(range(count), order_of(len(clouds)), strict=False):
        clouds[index].header = header(stamp_of(number, rate_hz), clouds[index].header.frame_id)
        publisher.publish(clouds[index])
        time.sleep(max(0.0, start + (number + 1) / rate_hz - time.monotonic()))
    time.sleep(_DISCOVERED_S)
    print(f"sent {count} in {time.monotonic() - start - _DISCOVERED_S:.2f} s")
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
