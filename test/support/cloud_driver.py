"""`python -m cloud_driver FRAME`: a driver that publishes one scan on /points again and again until it is told to end.

As Livox' message where the frame is `livox`, else as PointCloud2.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from typing import Any

import numpy as np
import pytest
import rclpy
from livox_messages import fast_cdr, install_livox_package
from mini_data import POSES, scan_room
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from svc_ros.ros.topics.conversions import cloud_message


def main(frame_id: str) -> None:
    points, is_livox = scan_room(POSES[0], seed=0), frame_id == "livox"

    def message(stamp_ns: int) -> Any:
        if is_livox:
            return fast_cdr(points, np.arange(len(points)) * 1000, stamp_ns, frame_id)
        return cloud_message(points, stamp_ns, frame_id)

    rclpy.init()
    with pytest.MonkeyPatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        node = Node("livox_lidar_publisher")
        publisher = node.create_publisher(
            install_livox_package(patch) if is_livox else PointCloud2, "/points", QoSProfile(depth=10)
        )
        for stamp_ns in itertools.count(10**9, 10**8):
            publisher.publish(message(stamp_ns))
            time.sleep(0.1)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
