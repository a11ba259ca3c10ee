"""Starts the registration node: `ros2 launch svc_ros registration.launch.py source:=/a/points target:=/b/points`.

`ros2 launch svc_ros registration.launch.py --show-args` tells all arguments.
"""

from pathlib import Path

from launch.actions import LogInfo
from launch_ros.actions import Node

from svc_ros.ros.discovery.inputs import find_live, full_name
from svc_ros.ros.launch_arguments import MODE, MODES, NODE_NAME, describe, given_values
from svc_ros.ros.middleware import profile_environment

ARGUMENTS = {
    "mode": MODE,
    "preset": ("lidar_outdoor", "defaults of all parameters: lidar_outdoor, lidar_indoor, rgbd_indoor or auto"),
    "method": ("svc", "how a pose is chosen and judged: svc, svc_paper or sc2"),
    "params_file": ("", "YAML file of parameters; what it sets has precedence over all arguments; '' for none"),
    "source": ("", "topic of the clouds that are aligned (pair, candidates of loop_closure); '' for source_points"),
    "target": ("", "topic of the clouds that they are aligned to; '' for target_points"),
    "points": ("", "topic of the scans (all modes but pair); '' for points if it is there, else the only one"),
    "initial_guess": ("initial_guess", "topic of guesses of the source's pose in the target frame"),
    "initialpose": ("initialpose", "topic of poses in the map that others tell (localization)"),
    "odom": ("odom", "topic of odometry (odometry:=topic)"),
    "odometry": ("own", "where loop_closure and localization have odometry from: own, topic or tf"),
    "odom_frame": ("odom", "frame of the odometry"),
    "base_frame": ("", "frame whose pose is told; '' the cloud's, in scan_matching with publish_tf a fixed base_link"),
    "sensor_frame": ("", "frame of the sensor, where clouds are in another one; '' for the cloud's frame"),
    "publish_tf": ("false", "true or false: accepted transforms on /tf, in localization map_frame to odom_frame"),
    "invert_odom_tf": ("false", "true or false: scan_matching's /tf has odom_frame as the child, not as the parent"),
    "map_frame": ("", "pair: where odom_frame stands in this, on /tf, '' for not; localization: the map, '' for map"),
    "graph_file": ("", "loop_closure writes its pose graph here; '' for nowhere"),
    "map_folder": ("", "localization: the folder of the map, as svc_ros map makes it"),
    "told_by": ("topic", "localization judges poses of others: topic (initialpose), tf or none"),
    "publish_initialpose": ("false", "true or false: localization tells others on initialpose when they are lost"),
    "process_every": ("false", "true or false: compute every pair or scan, however many wait: for bags"),
    "reliable": ("false", "true or false: ask for reliable clouds, which needs publishers that are reliable"),
    "namespace": ("", "namespace of the node"),
    "use_sim_time": ("false", "true or false: take the time from /clock"),
    "rviz": ("false", "true or false: show target, aligned source, verdict and sight lines in RViz (needs rviz2)"),
    "fixed_frame": ("", "RViz's fixed frame: in mode pair that of the target clouds; '' for odom_frame, or the map's"),
}
CHOICES = {
    "mode": MODES,
    "preset": ["lidar_outdoor", "lidar_indoor", "rgbd_indoor", "auto"],
    "method": ["svc", "svc_paper", "sc2"],
    "odometry": ["own", "topic", "tf"],
    "told_by": ["topic", "tf", "none"],
}
TEXTS = (
    "mode", "preset", "method", "odometry", "odom_frame", "base_frame", "sensor_frame", "map_frame", "graph_file",
    "map_folder", "told_by",
)  # fmt: skip
PARAMETER_SWITCHES = ("publish_tf", "invert_odom_tf", "publish_initialpose", "process_every", "use_sim_time")
SWITCHES = (*PARAMETER_SWITCHES, "reliable", "rviz")  # true or false
INPUTS = {"source_points": "source", "target_points": "target", "points": "points"}
OTHER_INPUTS = ("initial_guess", "initialpose", "odom")
SHOWN = ("aligned", "blocked_points", "sight_lines", "pose", "odometry", "path")
RVIZ_CONFIG = Path(__file__).parent.parent / "config" / "svc_ros.rviz"


def generate_launch_description():
    """The node and, if asked for, RViz."""
    return describe(ARGUMENTS, CHOICES, start)


def start(context):
    """What the arguments ask for, whose values are known by now."""
    given, found = find_live(given_values(context, ARGUMENTS, SWITCHES))
    node = Node(
        package="svc_ros",
        executable="registration_node",
        name=NODE_NAME,
        namespace=given["namespace"],
        parameters=[parameters(given), *([given["params_file"]] if given["params_file"] else [])],
        remappings=[*((topic, given[name]) for topic, name in INPUTS.items()), *((n, given[n]) for n in OTHER_INPUTS)],
        output="screen",
    )
    said = [LogInfo(msg=f"found: {line}") for line in found]
    return [*said, node, rviz(given)] if given["rviz"] == "true" else [*said, node]


def parameters(given):
    """The node's parameters; a text that is empty stays the default."""
    values = {name: given[name] for name in TEXTS if given[name]}
    values |= {name: given[name] == "true" for name in PARAMETER_SWITCHES}
    if given["reliable"] == "true":
        topics = (full_name(given[name], given["namespace"]) for name in INPUTS.values())
        values |= {f"qos_overrides.{topic}.subscription.reliability": "reliable" for topic in topics}
    return values


def rviz(given):
    """RViz with the package's configuration; its absolute names are turned into those of this node."""
    own = [(f"/{NODE_NAME}/{name}", f"{NODE_NAME}/{name}") for name in SHOWN]
    usual = (given["map_frame"] or "map") if given["mode"] == "localization" else given["odom_frame"]
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=given["namespace"],
        arguments=["-d", str(RVIZ_CONFIG), "-f", given["fixed_frame"] or usual],
        parameters=[{"use_sim_time": given["use_sim_time"] == "true"}],
        additional_env=profile_environment(),  # who listens to the same clouds
        remappings=[*own, ("/target_points", given["target"]), ("/points", given["points"])],
    )
