"""`svc_ros verify`: is this pose of somebody else right?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svc_ros.cli.console import check_json_target
from svc_ros.cli.one_pair import OnePair
from svc_ros.cli.options import (
    ColumnsOption,
    ConfigOption,
    FailOption,
    JsonOption,
    MethodOption,
    PresetOption,
    SourceArgument,
    TargetArgument,
    read_wanted,
)
from svc_ros.core.config import Config
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Scan

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
    columns: ColumnsOption = "",
    fail_on_reject: FailOption = False,
    json_target: JsonOption = None,
) -> None:
    """Judge a given pose of SOURCE in the frame of TARGET."""
    from svc_ros.io.transform_files import read_transform

    wanted = read_wanted(preset, method, config_file)
    check_json_target(json_target)
    T = read_transform(transform)

    def judge(source_scan: Scan, target_scan: Scan, config: Config) -> RegistrationResult:
        from svc_ros.core import registration

        return registration.verify(source_scan, target_scan, T, config)

    OnePair(source, target, wanted, json_target, fail_on_reject, columns).answer("verifying", judge)
