"""Stand-ins for `launch` and `launch_ros` that record what a launch file asks for; neither comes as a wheel."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


class Recorded:
    """Something that a launch file makes: what it was given."""

    def __init__(self, *given: Any, **options: Any) -> None:
        self.given, self.options = given, options


class Node(Recorded): ...


class ExecuteProcess(Recorded): ...


class DeclareLaunchArgument(Recorded): ...


class IncludeLaunchDescription(Recorded): ...


class PythonLaunchDescriptionSource(Recorded): ...


class LaunchDescription(Recorded): ...


class OpaqueFunction(Recorded): ...


class LaunchConfiguration:
    """The value of an argument; the context is a dict here."""

    def __init__(self, name: str, default: str | None = None) -> None:
        self.name, self.default = name, default

    def perform(self, context: dict[str, str]) -> str:
        """The value; KeyError for an argument that nobody declared."""
        return context[self.name] if self.default is None else context.get(self.name, self.default)


CONTENT: dict[str, tuple[type, ...]] = {
    "launch": (LaunchDescription,),
    "launch.actions": (DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, OpaqueFunction),
    "launch.substitutions": (LaunchConfiguration,),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
}


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The launch file as a module that uses the stand-ins."""
    for name, classes in CONTENT.items():
        module = ModuleType(name)
        vars(module).update({c.__name__: c for c in classes})
        monkeypatch.setitem(sys.modules, name, module)
    return load_real(path)


def load_real(path: Path) -> ModuleType:
    """The launch file as a module."""
    spec = importlib.util.spec_from_file_location(path.name.replace(".", "_"), path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def started(module: ModuleType, **given: str) -> list[Any]:
    """What the launch file starts with these arguments, every other one at its default."""
    (description,) = module.generate_launch_description().given
    declared = [entity for entity in description if isinstance(entity, DeclareLaunchArgument)]
    (opaque,) = [entity for entity in description if isinstance(entity, OpaqueFunction)]
    context = {argument.given[0]: argument.options["default_value"] for argument in declared}
    started_ones: list[Any] = opaque.options["function"]({**context, **given})
    return started_ones
