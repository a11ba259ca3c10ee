"""`svc_ros evaluate`: scans with reference poses, measured; own data sets and benchmarks of the field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from svc_ros.cli.console import check_json_target, key_value_table, progress, summary_console, write_json
from svc_ros.cli.options import (
    ConfigOption,
    JsonOption,
    LimitOption,
    MethodOption,
    PresetOption,
    SchedulerOption,
    Settings,
    WorkersOption,
    choose_from,
    read_wanted,
)
from svc_ros.core.errors import InputError

if TYPE_CHECKING:
    from svc_ros.core.auto_preset import Choice
    from svc_ros.evaluation.runner import Crew
    from svc_ros.io.datasets import CandidatePair, Dataset, Pair

FIRST_SCANS = 4  # by which `auto` chooses for a whole data set

FoldersArgument = Annotated[
    list[Path], typer.Argument(metavar="DIR...", help="Folders with a dataset.json, or a benchmark's (--suite).")
]
SuiteOption = Annotated[
    str | None,
    typer.Option(
        "--suite",
        metavar="NAME",
        help="Layout of DIR: kitti, kitti-loops, lokitti, rotkitti, 3dmatch, 3dlomatch, mulran, lonuscenes, "
        "rotnuscenes.",
    ),
]
GivenOption = Annotated[
    Path | None,
    typer.Option("--correspondences", metavar="DIR", help="Correspondences computed elsewhere, one .npz a pair."),
]
RefinedOption = Annotated[
    Path | None,
    typer.Option("--refined", metavar="DIR", help="Where kitti and mulran keep refined references (DIR/icp)."),
]


def evaluate(
    folders: FoldersArgument,
    suite: SuiteOption = None,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    limit: LimitOption = None,
    workers: WorkersOption = 1,
    scheduler: SchedulerOption = None,
    correspondences: GivenOption = None,
    refined: RefinedOption = None,
    json_target: JsonOption = None,
) -> None:
    """Register every pair of a data set and compare with its references; judge its labelled poses too."""
    check_json_target(json_target)
    if scheduler is not None and workers != 1:
        raise InputError("evaluate: expected either --workers or --scheduler, found both")
    datasets = [_read(folder, suite, correspondences, refined, scheduler) for folder in folders]
    wanted = [read_wanted(preset, method, config_file, default_preset=d.preset) for d in datasets]
    settings = [w.settle(partial(choose_for, d)) for w, d in zip(wanted, datasets, strict=True)]
    crew = workers if scheduler is None else _crew(scheduler, datasets)
    with progress(f"evaluating {', '.join(dataset.name for dataset in datasets)}") as on_progress:
        from svc_ros.evaluation.runner import evaluate_datasets

        sets = list(zip(datasets, (s.config for s in settings), strict=True))
        reports = evaluate_datasets(sets, limit, crew, on_progress)
    _name_presets(reports, settings)
    write_json(_joined(reports), json_target)
    console = summary_console(json_target)
    for report in reports:
        _show_report(console, report)
    if len(reports) > 1:
        console.print(key_value_table("all together", _joined(reports)["total"]))


def _read(folder: Path, suite: str | None, given: Path | None, refined: Path | None, scheduler: str | None) -> Dataset:
    import dataclasses

    from svc_ros.io.datasets import read_dataset
    from svc_ros.io.suites import read_suite

    if given is not None and not given.is_dir():
        raise InputError(f"--correspondences {given}: expected a folder of .npz files, found none")
    if scheduler is not None:  # workers may have been started in another folder
        folder, given, refined = folder.resolve(), given and given.resolve(), refined and refined.resolve()
    dataset = read_dataset(folder) if suite is None else read_suite(suite, folder, refined)
    return dataclasses.replace(dataset, correspondences=given)


def choose_for(dataset: Dataset) -> Choice:
    """What `auto` makes of a data set, by the first scans of its pairs: all of its pairs share one configuration."""
    pairs: list[Pair | CandidatePair] = [*dataset.pairs, *dataset.negatives, *dataset.candidates]
    names = dict.fromkeys(name for pair in pairs for name in (pair.source, pair.target))
    return choose_from([dataset.read_scan(name) for name in list(names)[:FIRST_SCANS]])


def _crew(scheduler: str, datasets: Sequence[Dataset]) -> Crew:
    from svc_ros.evaluation.distributed import run_over

    paths = {path for dataset in datasets for path in (dataset.root, dataset.correspondences) if path is not None}
    return partial(run_over, scheduler, paths=sorted(paths))


def _name_presets(reports: Sequence[dict[str, Any]], settings: Sequence[Settings]) -> None:
    for report, used in zip(reports, settings, strict=True):
        report.update(used.told())


def _joined(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One data set's report as it is, several under `datasets` with their `total`."""
    from svc_ros.evaluation.summary import summarise_total

    return reports[0] if len(reports) == 1 else {"datasets": list(reports), "total": summarise_total(reports)}


def _show_report(console: Console, report: Mapping[str, Any]) -> None:
    chosen = report.get("chosen")
    which = f": {chosen['preset']}, {chosen['why']}" if chosen else ""
    title = f"{report['dataset']}: method {report['method']}, preset {report['preset']}{which}"
    console.print(Text(title, "bold"), soft_wrap=True)
    sections = {"registration": report["registration"], "negatives": report["negatives"]}
    for name, section in sections.items():
        if section and section["num_pairs"]:
            rows = {key: value for key, value in section.items() if key != "pairs"}
            console.print(key_value_table(name, rows))
    for name, section in report.get("recall", {}).items():
        rows = {key: value for key, value in section.items() if key != "groups"}
        by_group = {f"recall {group}": values["recall"] for group, values in section["groups"].items()}
        console.print(key_value_table(f"recall ({name})", {**rows, **by_group}))
    if report["decision"]:
        rows = dict(report["decision"])
        origins = rows.pop("false_accepted_by_origin")
        false_accepted = ", ".join(f"{origin} {count}" for origin, count in origins.items())
        console.print(key_value_table("decision", {**rows, "false_accepted_by_origin": false_accepted}))
    times = dict(report["time_ms"])
    stages = times.pop("stages_p50")
    console.print(key_value_table("time [ms]", times | {f"{name}_p50": ms for name, ms in stages.items()}))
