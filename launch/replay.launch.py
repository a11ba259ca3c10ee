"""Plays a bag to the registration node: `ros2 launch svc_ros replay.launch.py bag:=drive/bag mode:=scan_matching`.

The arguments of registration.launch.py may be given as well. Everything stays until Ctrl-C, to be looked at.
"""

from pathlib import Path

from launch.actions import ExecuteProcess, IncludeLaunchDescription, LogInfo
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from svc_ros.ros.discovery.inputs import find_in_bag
from svc_ros.ros.launch_arguments import MODE, MODES, NODE_NAME, describe, given_values
from svc_ros.ros.middleware import profile_environment

ARGUMENTS = {
    "bag": (None, "the bag"),
    "mode": MODE,
    "player": ("svc_ros", "svc_ros: bag_player sends clouds, nothing is lost; ros2: `ros2 bag play` sends every topic"),
    "topic": ("", "topic of the clouds in the bag; '' for the only one, with player ros2 for points if it is there"),
    "rate": ("1.0", "player svc_ros: pairs or scans a second, 0 for no limit; player ros2: factor on the speed"),
    "stride": ("1", "player svc_ros, mode pair: scan k + stride is registered to scan k"),
}
CHOICES = {"mode": MODES, "player": ["svc_ros", "ros2"]}
# The player's own topics; absolute, so that a namespace of the node does not matter.
TOPICS = {"source": "/source_points", "target": "/target_points", "points": "/points"}
WAIT_S = "120"  # the node's first start compiles


def generate_launch_description():
    """The node, and a player for it."""
    return describe(ARGUMENTS, CHOICES, start)


def start(context):
    """What the arguments ask for, whose values are known by now."""
    given = given_values(context, ARGUMENTS)
    source = PythonLaunchDescriptionSource(str(Path(__file__).parent / "registration.launch.py"))
    if given["player"] == "ros2":
        of_node = ((name, LaunchConfiguration(name, default="")) for name in ("publish_tf", "base_frame"))
        found, said = find_in_bag({**given, **{name: value.perform(context) for name, value in of_node}})
        node = IncludeLaunchDescription(source, launch_arguments=node_arguments(given, found).items())
        told = [LogInfo(msg=f"found: {line}") for line in said]
        player = ExecuteProcess(cmd=ros2_command(given), output="screen", additional_env=profile_environment())
        return [*told, node, player]
    node = IncludeLaunchDescription(source, launch_arguments=node_arguments(given, {}).items())
    namespace = LaunchConfiguration("namespace", default="").perform(context).strip("/")
    words = player_words(given, f"/{namespace}/{NODE_NAME}" if namespace else f"/{NODE_NAME}")
    return [node, Node(package="svc_ros", executable="bag_player", arguments=words, output="screen")]


def node_arguments(given, found):
    """Arguments of registration.launch.py that follow from the player and the bag; others are left to the user."""
    common = {"mode": given["mode"], "process_every": "true"}
    if given["player"] == "svc_ros":
        return {**common, "reliable": "true", **TOPICS}
    return {**common, "use_sim_time": "true", **found}


def player_words(given, node_name):
    """Arguments of bag_player. It waits for each decision, except where a scan may have none."""
    words = [given["bag"], "--rate", given["rate"], "--wait-for-subscribers", WAIT_S]
    words += ["--topic", given["topic"]] if given["topic"] else []
    words += ["--stride", given["stride"]] if given["mode"] == "pair" else ["--scans"]
    return words if given["mode"] == "loop_closure" else [*words, "--wait-decisions", "--node-name", node_name]


def ros2_command(given):
    """`ros2 bag play` with the clock that the node goes by."""
    return ["ros2", "bag", "play", given["bag"], "--clock", "--rate", given["rate"]]
