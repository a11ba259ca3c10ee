"""`svc_ros config`: a preset as the YAML that --config and the node read."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from svc_ros.cli.options import ConfigOption, MethodOption, read_wanted
from svc_ros.core.config import PRESETS

_PRINTED = "lidar_outdoor"

NameArgument = Annotated[
    str | None, typer.Argument(metavar="[PRESET]", help=f"One of {', '.join(PRESETS)}; {_PRINTED} by default.")
]
OutputOption = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write to a file, not to stdout.")]


def config(
    preset: NameArgument = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    out: OutputOption = None,
) -> None:
    """Print a preset as YAML, with units and ranges: a file to change and to pass as --config."""
    from svc_ros.io.config_yaml import config_to_yaml

    settings = read_wanted(preset, method, config_file, _PRINTED).settle()
    text = config_to_yaml(settings.config, settings.preset)
    if out is None:
        sys.stdout.write(text)
    else:
        out.write_text(text, encoding="utf-8")
