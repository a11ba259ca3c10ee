"""Clouds and jobs of the node as plain objects, where no message class is needed."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np

from svc_ros.io.clouds.point_cloud2 import cloud_layout
from svc_ros.ros.streams.worker import Cloud, PairJob


def plain_cloud(points: np.ndarray, stamp_ns: int = 0, frame: str = "lidar") -> Cloud:
    """A cloud as a plain object with the attributes of sensor_msgs/PointCloud2."""
    layout = cloud_layout(points)
    names = ("fields", "point_step", "row_step", "width", "height", "is_bigendian", "is_dense", "data")
    stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=frame), **{name: getattr(layout, name) for name in names}
    )
    return Cloud(message, stamp_ns, time.monotonic())


def small_pair(stamp_ns: int) -> PairJob:
    """A pair of clouds of one point."""
    return PairJob(plain_cloud(np.ones((1, 3)), stamp_ns), plain_cloud(np.ones((1, 3)), stamp_ns))
