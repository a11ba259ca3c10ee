"""Finds the robot in a map: `ros2 launch svc_ros localization.launch.py map_folder:=maps/site points:=/lidar/points`.

The arguments of registration.launch.py may be given as well; `preset` and `mode` are settled here.
"""

from pathlib import Path

from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from svc_ros.ros.launch_arguments import describe, given_values

ARGUMENTS = {
    "map_folder": (None, "the folder of the map, as `svc_ros map BAG --out DIR` makes it"),
    "odometry": ("tf", "odometry: tf (from odom_frame to the clouds' frame), topic (odom), or own motion"),
    "publish_tf": ("false", "true or false: map_frame to odom_frame on /tf, for navigation; nobody else may send it"),
    "base_frame": ("base_link", "frame of the robot, whose pose is told; '' for the clouds' own"),
}
CHOICES = {"odometry": ["own", "topic", "tf"]}
SWITCHES = ("publish_tf",)


def generate_launch_description():
    """The node in mode localization."""
    return describe(ARGUMENTS, CHOICES, start)


def start(context):
    """What the arguments ask for, whose values are known by now."""
    given = given_values(context, ARGUMENTS, SWITCHES)
    source = PythonLaunchDescriptionSource(str(Path(__file__).parent / "registration.launch.py"))
    settled = {"mode": "localization", "preset": "auto"}
    return [IncludeLaunchDescription(source, launch_arguments={**given, **settled}.items())]
