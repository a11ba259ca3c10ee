"""`svc_ros register`: two scan files, one decision."""

from __future__ import annotations

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


def register(
    source: SourceArgument,
    target: TargetArgument,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    columns: ColumnsOption = "",
    fail_on_reject: FailOption = False,
    json_target: JsonOption = None,
) -> None:
    """Register SOURCE to TARGET from any starting pose, and say whether the pose can be trusted."""
    wanted = read_wanted(preset, method, config_file)
    check_json_target(json_target)
    OnePair(source, target, wanted, json_target, fail_on_reject, columns).answer("registering", _register)


def _register(source: Scan, target: Scan, config: Config) -> RegistrationResult:
    from svc_ros.core import registration

    return registration.register(source, target, config)
