"""`svc_ros view`: one decision on two scan files, as a page to turn and look at."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from svc_ros.cli.console import note, working
from svc_ros.cli.options import (
    ColumnsOption,
    ConfigOption,
    PresetOption,
    SourceArgument,
    TargetArgument,
    choose_from,
    read_wanted,
)
from svc_ros.cli.scans import read_scans
from svc_ros.core.errors import ConfigError, InputError

ResultOption = Annotated[
    Path, typer.Option("--result", metavar="FILE", help="The decision, as register and verify write it with --json.")
]
OutOption = Annotated[Path, typer.Option("--out", metavar="HTML", help="Page to write.")]


def view(
    source: SourceArgument,
    target: TargetArgument,
    result_file: ResultOption,
    out: OutOption = Path("view.html"),
    preset: PresetOption = None,
    config_file: ConfigOption = None,
    columns: ColumnsOption = "",
) -> None:
    """Show a decision in 3D: both scans as the judged pose puts them, red where a sensor looked through the other scan.

    Red points are denied surface, red lines blocked sight lines, green lines clear ones.

    The preset is that of the decision; a decision made with --config needs the same file here.
    """
    record = _read_record(result_file)
    _check_names(record, source, target, result_file)
    with working("looking"):
        from svc_ros.io.results import result_from_json
        from svc_ros.report.look_again import look_again
        from svc_ros.report.report import write_view
        from svc_ros.report.scenes import make_scene

        try:
            result = result_from_json(record)
            told = str(record["preset"]) if record.get("preset") else None
            wanted = read_wanted(preset or (None if config_file else told), result.method or None, config_file)
        except (InputError, ConfigError) as error:
            raise type(error)(f"{result_file}: {error}") from None
        files = read_scans(source, target, columns)
        settings = wanted.settle(lambda: choose_from(files.scans))
        source_scan, target_scan = files.prepare(settings.config)
        try:
            result = look_again(source_scan, target_scan, result, settings.config)
        except InputError as error:
            raise InputError(
                f"{result_file}: {error}: it is of other scans, or of another --preset or --config"
            ) from None
        record |= {"source": str(source), "target": str(target)}
        write_view(out, record, make_scene(0, source_scan, target_scan, result), f"{source.name} onto {target.name}")
    note(f"wrote {out}")


def _read_record(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{path}: expected one JSON object, as register and verify write it with --json") from None
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected one JSON object, found {type(value).__name__}")
    return value


def _check_names(record: dict[str, Any], source: Path, target: Path, result_file: Path) -> None:
    """Scans may have moved, but their names must not have changed places."""
    told = [Path(str(record.get(side, ""))).name for side in ("source", "target")]
    if told[0] != told[1] and told == [target.name, source.name]:
        raise InputError(f"{result_file}: expected {told[0]} as source and {told[1]} as target, found them swapped")
