"""Bags of ROS 1 and ROS 2, read and written without ROS."""

from svc_ros.io.bags.reading import (
    Bag,
    CloudBagWriter,
    Damage,
    ResultWriter,
    TopicInfo,
    UnreadableCloud,
    pose_from_message,
)

__all__ = ["Bag", "CloudBagWriter", "Damage", "ResultWriter", "TopicInfo", "UnreadableCloud", "pose_from_message"]
