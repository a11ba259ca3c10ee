"""`svc_ros evaluate`: a folder of scans with reference poses, measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from svc_ros.cli.console import check_json_target, key_value_table, progress, summary_console, write_json
from svc_ros.cli.options import ConfigOption, JsonOption, MethodOption, PresetOption, resolve_settings

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder with a dataset.json.")]
LimitOption = Annotated[int | None, typer.Option("--limit", min=1, metavar="N", help="First N of each kind only.")]
WorkersOption = Annotated[int, typer.Option("--workers", min=1, metavar="N", help="Processes that share the pairs.")]


def evaluate(
    folder: FolderArgument,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    limit: LimitOption = None,
    workers: WorkersOption = 1,
    json_target: JsonOption = None,
) -> None:
    """Register every pair of a data set and compare with its references; judge its labelled poses too."""
    from svc_ros.io.datasets import read_dataset

    check_json_target(json_target)
    dataset = read_dataset(folder)
    settings = resolve_settings(preset, method, config_file, default_preset=dataset.preset)
    with progress(f"evaluating {dataset.name}") as on_progress:
        from svc_ros.evaluation.runner import evaluate_dataset

        report = evaluate_dataset(dataset, settings.config, limit, workers, on_progress)
    report["preset"] = settings.preset
    write_json(report, json_target)
    _show_report(summary_console(json_target), report)


def _show_report(console: Console, report: Mapping[str, Any]) -> None:
    title = f"{report['dataset']}: method {report['method']}, preset {report['preset']}"
    console.print(Text(title, "bold"), soft_wrap=True)
    sections = {"registration": report["registration"], "negatives": report["negatives"]}
    for name, section in sections.items():
        if section and section["num_pairs"]:
            rows = {key: value for key, value in section.items() if key != "pairs"}
            console.print(key_value_table(name, rows))
    if report["decision"]:
        rows = dict(report["decision"])
        origins = rows.pop("false_accepted_by_origin")
        false_accepted = ", ".join(f"{origin} {count}" for origin, count in origins.items())
        console.print(key_value_table("decision", {**rows, "false_accepted_by_origin": false_accepted}))
    times = dict(report["time_ms"])
    stages = times.pop("stages_p50")
    console.print(key_value_table("time [ms]", times | {f"{name}_p50": ms for name, ms in stages.items()}))
