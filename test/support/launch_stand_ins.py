"""Stand-ins for `launch` and `launch_ros` that record what a launch file asks for; neither comes as a wheel.

And for what launch files find by themselves in the running system.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, ModuleType
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


class LogInfo(Recorded): ...


class LaunchConfiguration:
    """The value of an argument; the context is a dict here."""

    def __init__(self, name: str, default: str | None = None) -> None:
        self.name, self.default = name, default

    def perform(self, context: dict[str, str]) -> str:
        """The value; KeyError for an argument that nobody declared."""
        return context[self.name] if self.default is None else context.get(self.name, self.default)


CONTENT: dict[str, tuple[type, ...]] = {
    "launch": (LaunchDescription,),
    "launch.actions": (DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription, LogInfo, OpaqueFunction),
    "launch.substitutions": (LaunchConfiguration,),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
}


class Graph:
    """The running system as a launch file sees it: nothing, unless a test says what there is."""

    topics: tuple[str, ...] = ()
    frame = "lidar"
    parents: Mapping[str, str] = MappingProxyType({})

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, *_exception: object) -> None: ...

    def clouds(self, _wanted: object) -> list[str]:
        return list(self.topics)

    def frame_of(self, topic: str) -> str:
        return self.frame if topic in self.topics else ""

    def static_parents(self, _is_enough: object) -> Mapping[str, str]:
        return self.parents


def load(path: Path, monkeypatch: pytest.MonkeyPatch, graph: type[Graph] = Graph) -> ModuleType:
    """The launch file as a module that uses the stand-ins."""
    seen = ModuleType("svc_ros.ros.discovery.graph")
    vars(seen)["Onlooker"] = graph
    monkeypatch.setitem(sys.modules, seen.__name__, seen)
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
    return [action for action in _actions(module, **given) if not isinstance(action, LogInfo)]


def said(module: ModuleType, **given: str) -> list[str]:
    """What it tells meanwhile."""
    return [action.options["msg"] for action in _actions(module, **given) if isinstance(action, LogInfo)]


def _actions(module: ModuleType, **given: str) -> list[Any]:
    (description,) = module.generate_launch_description().given
    declared = [entity for entity in description if isinstance(entity, DeclareLaunchArgument)]
    (opaque,) = [entity for entity in description if isinstance(entity, OpaqueFunction)]
    context = {argument.given[0]: argument.options["default_value"] for argument in declared}
    started_ones: list[Any] = opaque.options["function"]({**context, **given})
    return started_ones
