"""The names of `matching.more_descriptors`: built-in ones, and those that installed packages offer.

A package offers one by an entry point of the group `svc_ros.descriptors`. Names are looked up without importing
anything.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from svc_ros.core.config_fields import unknown_name
from svc_ros.core.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

KEY, GROUP = "matching.more_descriptors", "svc_ros.descriptors"
BUILT_IN = {"fpfh_wide": "svc_ros.core.matches.descriptors:describe_by_wide_fpfh"}  # name -> module:function


def split_names(text: str) -> tuple[str, ...]:
    """The names of a comma separated list, "" being none; ConfigError for an empty or a repeated name."""
    names = tuple(name.strip() for name in text.split(",")) if text.strip() else ()
    if "" in names or len(set(names)) < len(names):
        raise ConfigError(f"{KEY}: expected different names between commas, found {text!r}")
    return names


def check_names(text: str) -> None:
    """Raise ConfigError, listing those there are, unless every name of the list is that of one descriptor."""
    for name in split_names(text):
        find_descriptor(name)


def find_descriptor(name: str) -> EntryPoint:
    """Where a descriptor's function is. Raises ConfigError for a name that nobody offers, or more than one package."""
    offered = _offered()
    found = [point for point in offered if point.name == name]
    if not found:
        known = sorted({point.name for point in offered})
        hint = f"install the package that offers it in the same environment, by an entry point of the group {GROUP}"
        raise ConfigError(f"{unknown_name(KEY, name, known)}; {hint}")
    if len(found) > 1:
        owners = " and ".join(sorted(owner_of(point) for point in found))
        raise ConfigError(f"{KEY}: expected one descriptor {name!r}, found it in {owners}: remove one")
    return found[0]


def owner_of(point: EntryPoint) -> str:
    """The package that offers a descriptor, for messages."""
    return "svc_ros itself" if point.dist is None else f"package {point.dist.name}"


def _offered() -> list[EntryPoint]:
    from importlib.metadata import EntryPoint, entry_points  # the help of the command line does without

    return [EntryPoint(name, place, GROUP) for name, place in BUILT_IN.items()] + list(entry_points(group=GROUP))
