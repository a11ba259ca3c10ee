"""What the launch files have in common: arguments, and how they are declared and read. Needs `launch` when called."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from svc_ros.core.errors import ConfigError
from svc_ros.io.config_yaml import NODE_NAME

if TYPE_CHECKING:
    from launch import LaunchContext, LaunchDescription

__all__ = ["MODE", "MODES", "NODE_NAME", "describe", "given_values"]

Arguments = Mapping[str, tuple[str | None, str]]  # default (None: must be given) and description by name

MODE = ("pair", "what the node does: pair, scan_matching, loop_closure or localization")
MODES = ["pair", "scan_matching", "loop_closure", "localization"]


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


def given_values(context: LaunchContext, arguments: Arguments, switches: Collection[str] = ()) -> dict[str, str]:
    """The arguments' values by name; those of `switches` are `true` or `false`, however they were capitalised.

    Raises ConfigError for a switch that is neither.
    """
    from launch.substitutions import LaunchConfiguration

    values = {name: LaunchConfiguration(name).perform(context) for name in arguments}
    return values | {name: _switch(name, values[name]) for name in switches}


def _switch(name: str, value: str) -> str:
    """As Python, YAML and XML write it; a list of choices would have to name every spelling."""
    text = value.strip().lower()
    if text not in ("true", "false"):
        raise ConfigError(f"launch argument {name}: expected true or false, found {value!r}")
    return text
