"""What a value of the configuration knows about itself: text, unit, range, choices; and the check against them."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from svc_ros.core.errors import ConfigError


@dataclass(frozen=True)
class FieldInfo:
    """What is known about one value of the tree: `name` is its dotted path, `default` its value in the tree."""

    name: str
    default: float | int | str | bool
    description: str
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]


def value(default: Any, text: str, unit: str = "", low: float | None = None, high: float | None = None,
          choices: tuple[str, ...] = ()) -> Any:  # fmt: skip
    """A field of the configuration tree with all that is known about it."""
    meta = {"description": text, "unit": unit, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=meta)


@dataclass(frozen=True)
class Group:
    """Checks every value against its own metadata when the group is built; what it holds besides are groups."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            if f.metadata:
                checked = check_value(f.name, getattr(self, f.name), f)
                object.__setattr__(self, f.name, checked)


def walk(group: Group, prefix: str = "") -> Iterator[FieldInfo]:
    """Yield every value of a group, and of the groups in it, in order: for parameters, YAML and help texts.

    Names are dotted, and begin with the prefix.
    """
    for f in dataclasses.fields(group):
        held = getattr(group, f.name)
        if isinstance(held, Group):
            yield from walk(held, f"{prefix}{f.name}.")
        else:
            yield FieldInfo(prefix + f.name, held, **f.metadata)


def check_value(name: str, value: Any, f: dataclasses.Field[Any]) -> Any:
    """Return `value` in the type of the field's default, or raise ConfigError naming what was expected."""
    kind, meta = type(f.default), f.metadata
    if isinstance(value, int) and not isinstance(value, bool) and kind is float:
        value = float(value)
    if not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
        raise ConfigError(f"{name}: expected {kind.__name__}, found {value!r}")
    if meta["choices"] and value not in meta["choices"]:
        raise ConfigError(unknown_name(name, str(value), meta["choices"]))
    low, high = meta["low"], meta["high"]
    if (low is not None and not value >= low) or (high is not None and not value <= high):
        span = f"{low:g} to {high:g} {meta['unit']}".rstrip()
        raise ConfigError(f"{name}: expected a value from {span}, found {value}")
    return value


def unknown_name(what: str, found: str, known: tuple[str, ...] | list[str]) -> str:
    """One line for a name that does not exist, with the nearest one that does."""
    near = difflib.get_close_matches(str(found), known, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{what}: unknown name {found!r}{hint} (known: {', '.join(known)})"
