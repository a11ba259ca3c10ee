"""`svc_ros verify`: is this pose of somebody else right?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svc_ros.cli.console import check_json_target, summary_console, working, write_json
from svc_ros.cli.options import ConfigOption, JsonOption, MethodOption, PresetOption, choose_from, read_wanted
from svc_ros.cli.register import FailOption, SourceArgument, TargetArgument
from svc_ros.cli.results import exit_for, show_result
from svc_ros.cli.scans import read_scans

TransformOption = Annotated[
    Path,
    typer.Option(
        "--transform",
        metavar="FILE",
        help="Pose p_target = T p_source: 16 or 12 numbers, JSON (also a result of register) or .npy.",
    ),
]


def verify(
    source: SourceArgument,
    target: TargetArgument,
    transform: TransformOption,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    fail_on_reject: FailOption = False,
    json_target: JsonOption = None,
) -> None:
    """Judge a given pose of SOURCE in the frame of TARGET."""
    from svc_ros.io.transform_files import read_transform

    wanted = read_wanted(preset, method, config_file)
    check_json_target(json_target)
    T = read_transform(transform)
    with working("verifying"):
        from svc_ros.core import registration
        from svc_ros.io.results import result_to_json

        files = read_scans(source, target)
        settings = wanted.settle(lambda: choose_from(files.scans))
        result = files.decide(settings.config, lambda s, t: registration.verify(s, t, T, settings.config))
    names = {"source": str(source), "target": str(target), **settings.told()}
    write_json(result_to_json(result, **names), json_target)
    show_result(summary_console(json_target), result, settings.shown())
    exit_for(result.accepted, fail_on_reject)
