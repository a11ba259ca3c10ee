"""What the launch files have in common: arguments, and how they are declared and read. Needs `launch` when called."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from svc_ros.io.config_yaml import NODE_NAME

if TYPE_CHECKING:
    from launch import LaunchContext, LaunchDescription

__all__ = ["MODE", "MODES", "NODE_NAME", "describe", "given_values"]

Arguments = Mapping[str, tuple[str | None, str]]  # default (None: must be given) and description by name

MODE = ("pair", "what the node does: pair, scan_matching or loop_closure")
MODES = ["pair", "scan_matching", "loop_closure"]


def describe(
    arguments: Arguments, choices: Mapping[str, Sequence[str]], start: Callable[[LaunchContext], list[Any]]
) -> LaunchDescription:
    """A launch file that declares these arguments, and starts what `start` returns once their values are known."""
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    from launch import LaunchDescription

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text, choices=choices.get(name))
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def given_values(context: LaunchContext, arguments: Arguments) -> dict[str, str]:
    """The arguments' values by name."""
    from launch.substitutions import LaunchConfiguration

    return {name: LaunchConfiguration(name).perform(context) for name in arguments}
