"""`svc_ros register`: two scan files, one decision."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svc_ros.cli.console import check_json_target, summary_console, working, write_json
from svc_ros.cli.options import ConfigOption, JsonOption, MethodOption, PresetOption, choose_from, read_wanted
from svc_ros.cli.results import exit_for, show_result
from svc_ros.cli.scans import read_scans

SourceArgument = Annotated[Path, typer.Argument(metavar="SOURCE", help="Scan to move (.bin .pcd .ply .npy .npz .las).")]
TargetArgument = Annotated[Path, typer.Argument(metavar="TARGET", help="Scan that stays; the pose is in its frame.")]
FailOption = Annotated[
    bool, typer.Option("--fail-on-reject", help="Exit with 3 where the pose is not accepted.", show_default=False)
]


def register(
    source: SourceArgument,
    target: TargetArgument,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    fail_on_reject: FailOption = False,
    json_target: JsonOption = None,
) -> None:
    """Register SOURCE to TARGET from any starting pose, and say whether the pose can be trusted."""
    wanted = read_wanted(preset, method, config_file)
    check_json_target(json_target)
    with working("registering"):
        from svc_ros.core import registration
        from svc_ros.io.results import result_to_json

        files = read_scans(source, target)
        settings = wanted.settle(lambda: choose_from(files.scans))
        result = files.decide(settings.config, lambda s, t: registration.register(s, t, settings.config))
    names = {"source": str(source), "target": str(target), **settings.told()}
    write_json(result_to_json(result, **names), json_target)
    show_result(summary_console(json_target), result, settings.shown())
    exit_for(result.accepted, fail_on_reject)
