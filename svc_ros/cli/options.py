"""Options that several commands share, and the one place where preset, YAML and command line become a Config."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from svc_ros.core.config import METHODS, PRESETS, Config, preset, unknown_name, with_values
from svc_ros.core.descriptor_names import check_names
from svc_ros.core.errors import ConfigError

DEFAULT_PRESET = "lidar_outdoor"

PresetOption = Annotated[
    str | None, typer.Option("--preset", metavar="NAME", help=f"Named configuration: {', '.join(PRESETS)}.")
]
MethodOption = Annotated[
    str | None, typer.Option("--method", metavar="NAME", help=f"How poses are chosen and judged: {', '.join(METHODS)}.")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="YAML", help="Values over the preset's; options win over the file.")
]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - writes it to stdout, alone.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Spread by Dask: local, or a scheduler's tcp://host:port."),
]


@dataclass(frozen=True)
class Settings:
    """A resolved configuration and the preset that it started from."""

    preset: str
    config: Config


def resolve_settings(
    preset_name: str | None, method: str | None, config_file: Path | None, default_preset: str = DEFAULT_PRESET
) -> Settings:
    """Build the configuration: the command line wins over the YAML file, the file over the preset.

    The preset itself is that of the command line, else the file's, else the default. Raises ConfigError for unknown
    names and values and for descriptors that are not installed, InputError for a file that cannot be read.
    """
    values: dict[str, Any] = {} if method is None else {"method": method}
    if config_file is None:
        name = preset_name or default_preset
        return Settings(name, with_values(preset(name), values))
    from svc_ros.io.config_yaml import read_config_file

    file = read_config_file(config_file)
    name = preset_name or file.preset or default_preset
    if preset_name is None and name not in PRESETS:
        raise ConfigError(f"{config_file}: {unknown_name('preset', name, list(PRESETS))}")
    config = with_values(file.applied_to(preset(name)), values)
    check_names(config.matching.more_descriptors)
    return Settings(name, config)
