"""Configuration <-> YAML, in the form of a ROS 2 parameter file, so that one file serves the programs and the node:

    /**:
      ros__parameters:
        preset: lidar_outdoor
        preprocess:
          voxel_size_m: 0.3

A plain mapping without the two wrapping lines is read too, and so are dotted names (`preprocess.voxel_size_m: 0.3`).
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from svc_ros.core.config import AUTO, PRESETS, Config, FieldInfo, preset, values_of, walk, with_values
from svc_ros.core.errors import ConfigError, InputError

NODE_NAME = "svc_registration"

# Parameters of the node that say where scans come from and where answers go; they are no part of a registration's
# Config, and are kept apart when a file is read. A name stands for everything below it, too (qos_overrides./points...).
NODE_KEYS = (
    "preset",
    "mode",
    "max_skew",
    "pair_timeout",
    "queue_size",
    "process_every",
    "sensor_frame",
    "sensor_origin",
    "tf_timeout",
    "publish_tf",
    "tf_child_frame",
    "autostart",
    "use_sim_time",
    "qos_overrides",
    "start_type_description_service",
)

_HEADER = """\
# Preset {preset} of svc_ros. Every value has its meaning, unit and range in the line above it.
# Programs: svc_ros COMMAND ... --config THIS_FILE
# Node:     ros2 run svc_ros registration_node --ros-args --params-file THIS_FILE
"""


@dataclass(frozen=True)
class ConfigFile:
    """What a file says. values: dotted names of the Config; node_values: names of NODE_KEYS, unchecked."""

    path: Path
    values: dict[str, Any]
    node_values: dict[str, Any]

    @property
    def preset(self) -> str | None:
        """The preset that the file is based on, or None where it does not say."""
        return self.node_values.get("preset")

    def applied_to(self, base: Config) -> Config:
        """The file's values over `base`, checked as a whole; ConfigError names the file and the key."""
        try:
            return with_values(base, self.values)
        except ConfigError as error:
            raise ConfigError(f"{self.path}: {error}") from None


def read_config(path: str | Path, base: Config) -> Config:
    """Read a configuration: the file's values over its own preset, or over `base` where it names none.

    An empty file changes nothing. Raises InputError for a file that cannot be read and ConfigError, naming file and
    key, for broken YAML, duplicate or unknown keys (with the nearest name) and values that do not fit.
    """
    found = read_config_file(path)
    if found.preset is None:
        return found.applied_to(base)
    try:
        return found.applied_to(preset(found.preset))
    except ConfigError as error:
        raise ConfigError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


def read_config_file(path: str | Path) -> ConfigFile:
    """Read a file's names and values without building a configuration; raises as `read_config` does."""
    path = Path(path)
    values = dict(_flattened(_unwrapped(_load(path), path), path))
    node_values = {name: value for name, value in values.items() if _is_node_key(name)}
    config_values = {name: value for name, value in values.items() if name not in node_values}
    known = list(values_of(Config()))
    for name in config_values:
        if name not in known:
            raise ConfigError(f"{path}: {_unknown_key(name, known)}")
    if not isinstance(node_values.get("preset", ""), str):
        raise ConfigError(f"{path}: preset: expected a name, found {node_values['preset']!r}")
    return ConfigFile(path, config_values, node_values)


def config_to_yaml(config: Config, preset_name: str = "") -> str:
    """Write every value as a parameter file, meaning, unit and range in a comment above it; preset "": no such key."""
    return _HEADER.format(preset=preset_name or "(none)") + _parameters(list(walk(config)), preset_name)


def changes_to_yaml(config: Config, preset_name: str, always: Sequence[str] = (), comment: str = "") -> str:
    """Write only the values that are not the preset's, and those named in `always`; comment: text above them."""
    base = values_of(preset(preset_name))
    told = [info for info in walk(config) if info.default != base[info.name] or info.name in always]
    lines = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    return _HEADER.format(preset=preset_name) + lines + _parameters(told, preset_name)


def _parameters(told: Sequence[FieldInfo], preset_name: str) -> str:
    lines = ["/**:", "  ros__parameters:"]
    if preset_name:
        lines += ["    # base of whatever this file does not say, one of " + ", ".join([*PRESETS, AUTO])]
        lines += [f"    preset: {preset_name}"]
    open_group = ""
    for info in told:
        group, _, leaf = info.name.rpartition(".")
        if group != open_group:
            lines += ["", f"    {group}:"]
            open_group = group
        indent = "      " if group else "    "
        lines += [f"{indent}# {_explained(info)}", f"{indent}{leaf}: {_scalar(info.default)}"]
    return "\n".join(lines) + "\n"


def config_folder() -> Path:
    """The folder of presets and profiles: in the checkout, else under share/ of the prefix that was installed into."""
    package = Path(__file__).resolve().parent.parent
    checkout = package.parent / "config"
    shares = [parent / "share" / "svc_ros" / "config" for parent in package.parents]
    return next((folder for folder in (checkout, *shares) if folder.is_dir()), checkout)


def write_preset_files(folder: str | Path) -> list[Path]:
    """Write one YAML file a preset into an existing folder and return the paths, in the order of PRESETS."""
    paths = [Path(folder) / f"{name}.yaml" for name in PRESETS]
    for path, (name, config) in zip(paths, PRESETS.items(), strict=True):
        try:
            path.write_text(config_to_yaml(config, name), "utf-8")
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    return paths


class _Loader(yaml.SafeLoader):
    """Plain data only; a key given twice is an error, and `1e-3` is a number as it is in ROS."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = str(self.construct_object(key_node, deep=True))
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} is given twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(  # YAML 1.1 itself asks for a dot and a signed exponent
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def _load(path: Path) -> Any:
    try:
        return yaml.load(path.read_text("utf-8"), _Loader)  # a SafeLoader
    except OSError as error:
        raise InputError(f"{path}: configuration cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected YAML text, found binary data") from None
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigError(f"{place}: not valid YAML: {problem or ' '.join(str(error).split())}") from None


def _unwrapped(content: Any, path: Path) -> dict[str, Any]:
    """The parameters of this node: under every matching `NODE: ros__parameters:`, or the plain mapping itself."""
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected names and values, found {content!r:.60}")
    nodes = {str(k): v["ros__parameters"] for k, v in content.items() if isinstance(v, dict) and "ros__parameters" in v}
    if not nodes:
        return content
    ours = [name for name in nodes if name.rpartition("/")[2] in ("**", NODE_NAME)]
    if not ours or len(nodes) < len(content):
        other = sorted(set(map(str, content)) - set(ours))
        raise ConfigError(f"{path}: expected parameters of /** or {NODE_NAME}, found those of {', '.join(other)}")
    return _merged(path, [nodes[name] or {} for name in ours])


def _merged(path: Path, sections: list[Any]) -> dict[str, Any]:
    merged: dict[str, Any] = {}
    for section in sections:  # a later section wins, as it does in ROS
        if not isinstance(section, dict):
            raise ConfigError(f"{path}: ros__parameters: expected names and values, found {section!r:.60}")
        merged.update(_flattened(section, path))
    return merged


def _flattened(values: dict[Any, Any], path: Path, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value); the same name in nested and in dotted form is an error."""
    seen: set[str] = set()
    for key, value in values.items():
        name = f"{prefix}{key}"
        pairs = list(_flattened(value, path, f"{name}.")) if isinstance(value, dict) else [(name, value)]
        for leaf, leaf_value in pairs:
            if leaf in seen:
                raise ConfigError(f"{path}: key {leaf!r} is given twice")
            seen.add(leaf)
            yield leaf, leaf_value


def _is_node_key(name: str) -> bool:
    return name.partition(".")[0] in NODE_KEYS


def _unknown_key(name: str, known: list[str]) -> str:
    """One line for a key that does not exist: the nearest name, whole or without its group."""
    group = [other for other in known if other.startswith(f"{name}.")]
    if group:
        return f"{name}: expected a group of values ({', '.join(other.rpartition('.')[2] for other in group)})"
    choices = {other: other for other in (*known, *NODE_KEYS)}
    by_leaf = {other.rpartition(".")[2]: other for other in reversed(known)}
    near = difflib.get_close_matches(name, choices, n=1, cutoff=0.6)
    if not near or "." not in name:
        near = [by_leaf[leaf] for leaf in difflib.get_close_matches(name.rpartition(".")[2], by_leaf, n=1)] or near
    hint = f"; did you mean {near[0]!r}?" if near else "; `svc_ros config` prints those there are"
    return f"unknown key {name!r}{hint}"


def _explained(info: FieldInfo) -> str:
    text = info.description + (f" [{info.unit}]" if info.unit else "")
    if info.choices:
        return f"{text}, one of {', '.join(info.choices)}"
    if info.low is not None and info.high is not None:
        return f"{text}, {info.low:.9g} to {info.high:.9g}"
    return text


def _scalar(value: float | int | str | bool) -> str:
    """A value as YAML that ROS reads with the same type: a float always has a dot."""
    if isinstance(value, float):
        return re.sub(r"^(-?\d+)(e|$)", r"\1.0\2", repr(value))
    if isinstance(value, str) and re.fullmatch(r"[a-z][a-z0-9_]*", value) and value not in ("yes", "no", "on", "off"):
        return value
    return json.dumps(value)  # true, 12, "text": JSON is YAML
