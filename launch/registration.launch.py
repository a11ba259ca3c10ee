"""Starts the registration node: `ros2 launch svc_ros registration.launch.py source:=/a/points target:=/b/points`."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

ARGUMENTS = {
    "preset": ("lidar_outdoor", "defaults of all parameters: lidar_outdoor, lidar_indoor or rgbd_indoor"),
    "method": ("svc", "how a pose is chosen and judged: svc, svc_paper or sc2"),
    "params_file": ("", "YAML file of parameters; what it sets has precedence over preset and method; '' for none"),
    "source": ("source_points", "topic of the clouds that are aligned"),
    "target": ("target_points", "topic of the clouds that they are aligned to"),
    "namespace": ("", "namespace of the node"),
    "use_sim_time": ("false", "take the time from /clock"),
}


def generate_launch_description():
    """One node, with or without a parameter file."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    parameters = {
        "preset": ParameterValue(given["preset"], value_type=str),
        "method": ParameterValue(given["method"], value_type=str),
        "use_sim_time": ParameterValue(given["use_sim_time"], value_type=bool),
    }
    common = {
        "package": "svc_ros",
        "executable": "registration_node",
        "name": "svc_registration",
        "namespace": given["namespace"],
        "remappings": [("source_points", given["source"]), ("target_points", given["target"])],
        "output": "screen",
    }
    no_file = EqualsSubstitution(given["params_file"], "")
    without_file = Node(**common, parameters=[parameters], condition=IfCondition(no_file))
    with_file = Node(**common, parameters=[parameters, given["params_file"]], condition=UnlessCondition(no_file))
    return LaunchDescription([*arguments, without_file, with_file])
