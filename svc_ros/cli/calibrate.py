"""`svc_ros calibrate`: which probability to demand so that wrong poses stay rare, by the user's own data."""

from __future__ import annotations

import importlib.util
import tempfile
import textwrap
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from svc_ros.cli.console import (
    check_json_target,
    key_value_table,
    make_output_folder,
    note,
    progress,
    summary_console,
    warn_of_damage,
    working,
    write_json,
)
from svc_ros.cli.evaluate import FIRST_SCANS, choose_for
from svc_ros.cli.options import (
    DEFAULT_PRESET,
    ConfigOption,
    JsonOption,
    LimitOption,
    MethodOption,
    PresetOption,
    ReferenceFrameOption,
    SensorOption,
    Settings,
    StrictOption,
    TopicOption,
    WorkersOption,
    choose_from,
    read_wanted,
)
from svc_ros.core.errors import InputError, MissingDependencyError

if TYPE_CHECKING:
    from svc_ros.core.auto_preset import Choice
    from svc_ros.core.config import Config
    from svc_ros.evaluation.bag_pairs import BagSource
    from svc_ros.io.datasets import Dataset

# Cloud topic, frame of the reference, frame of the sensor, whether damage is refused.
OfBags = tuple[str | None, str | None, str | None, bool]

DataArgument = Annotated[
    list[Path], typer.Argument(metavar="DIR|BAG...", help="Folders with a dataset.json, or bags with --reference.")
]
ReferencesOption = Annotated[
    list[Path] | None,
    typer.Option("--reference", metavar="TUM", help="Reference trajectory of a bag; once for each bag, in order."),
]
RateOption = Annotated[
    float, typer.Option("--max-wrong-rate", metavar="R", help="Largest share of pairs with a wrong acceptance.")
]
ConfidenceOption = Annotated[float, typer.Option("--confidence", metavar="C", help="Confidence of that promise.")]
RegisterOption = Annotated[bool, typer.Option("--register/--no-register", help="Register the pairs, too.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of the wrong poses that are made.")]
BestOption = Annotated[
    bool, typer.Option("--best-effort", help="Write the surest value where the data cannot keep the promise.")
]
PageOption = Annotated[bool, typer.Option("--page/--no-page", help="Write calibration.html.")]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder for calibration.yaml, .html and .json.")
]


def calibrate(
    data: DataArgument,
    reference: ReferencesOption = None,
    topic: TopicOption = None,
    reference_frame: ReferenceFrameOption = None,
    sensor_frame: SensorOption = None,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    max_wrong_rate: RateOption = 0.01,
    confidence: ConfidenceOption = 0.95,
    register: RegisterOption = True,
    limit: LimitOption = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 1,
    best_effort: BestOption = False,
    page: PageOption = True,
    out: OutOption = None,
    json_target: JsonOption = None,
    strict: StrictOption = False,
) -> None:
    """Choose decision.min_probability by labelled data, so that wrong acceptances stay below a rate.

    Poses that are right and poses made wrong on purpose are judged, and pairs registered. DIR of --out gets
    calibration.yaml for --config and for the node, calibration.html and calibration.json. Where the data are too few
    for the promise, what they can promise is told, and no YAML is written without --best-effort.
    """
    check_json_target(json_target)
    _check_page(page and out is not None)
    from svc_ros.evaluation.calibration.claims import pairs_needed

    needed = pairs_needed(max_wrong_rate, confidence)
    sources = _sources(data, reference or [], (topic, reference_frame, sensor_frame, strict))
    settings = _settings(sources, preset, method, config_file)
    if out is not None:
        make_output_folder(out)
    with tempfile.TemporaryDirectory(prefix="svc_ros_") as folder:
        sets = _opened(sources, settings, (limit or needed, limit or needed // 2), Path(folder))
        with progress(f"judging {', '.join(dataset.name for dataset, _ in sets)}") as on_progress:
            from svc_ros.evaluation.calibration.run import CalibrationOptions, calibrate
            from svc_ros.evaluation.calibration.summary import Goal

            goal = Goal(max_wrong_rate, confidence, settings.config.decision.min_probability)
            summary = calibrate(sets, CalibrationOptions(goal, register, limit, workers, seed), on_progress)
    summary = {**_told(settings), "method": settings.config.method, "seed": seed, **summary}
    write_json(summary, json_target)
    _show(summary_console(json_target), summary)
    if out is not None:
        _write(out, summary, settings, (page, best_effort, _ranges(sets)))


def _told(settings: Settings) -> dict[str, Any]:
    """The preset, and what `auto` chose under a name of its own: `chosen` is the calibrated value's row."""
    told = settings.told()
    return {"chosen_preset" if name == "chosen" else name: value for name, value in told.items()}


def _check_page(wanted: bool) -> None:
    if wanted and importlib.util.find_spec("plotly") is None:
        raise MissingDependencyError("calibration.html needs plotly: pip install plotly, or calibrate with --no-page")


def _sources(data: Sequence[Path], references: Sequence[Path], of_bags: OfBags) -> list[Dataset | BagSource]:
    """Data sets that are read, and bags with their references, in the order of the command line."""
    from svc_ros.evaluation.bag_pairs import BagSource
    from svc_ros.io.datasets import read_dataset

    twice = next((path for k, path in enumerate(data) if path.resolve() in [p.resolve() for p in data[:k]]), None)
    if twice is not None:
        raise InputError(f"{twice}: expected every set of data once, found it twice: its pairs would count double")
    bags = [path for path in data if not (path / "dataset.json").is_file()]
    for path in bags:
        if not path.exists():
            raise InputError(f"{path}: expected a folder with dataset.json, or a bag, found nothing")
        if not references:
            raise InputError(f"{path}: expected a dataset.json inside, or a bag with --reference TUM, found neither")
    if len(references) != len(bags):
        raise InputError(f"--reference: expected one for each bag ({len(bags)}), found {len(references)}")
    given = iter(references)
    return [BagSource(path, next(given), *of_bags) if path in bags else read_dataset(path) for path in data]


def _settings(
    sources: Sequence[Dataset | BagSource], preset: str | None, method: str | None, config_file: Path | None
) -> Settings:
    """One configuration for all, as one value comes out of it."""
    from svc_ros.io.datasets import Dataset

    names = {source: source.preset if isinstance(source, Dataset) else DEFAULT_PRESET for source in sources}
    wanted = {source: read_wanted(preset, method, config_file, name) for source, name in names.items()}
    found = [one.settle(partial(_choose, source)) for source, one in wanted.items()]
    bases = {
        settings.base: source.name if isinstance(source, Dataset) else str(source.bag)
        for settings, source in zip(found, sources, strict=True)
    }
    if len(bases) > 1:
        listed = ", ".join(f"{base} ({name})" for base, name in bases.items())
        raise InputError(f"calibrate: expected data of one preset, found {listed}: calibrate each, or name a --preset")
    return found[0]


def _choose(source: Dataset | BagSource) -> Choice:
    from svc_ros.io.bags import Bag
    from svc_ros.io.datasets import Dataset
    from svc_ros.replay.clouds import BagPart, first_scans

    if isinstance(source, Dataset):
        return choose_for(source)
    with Bag(source.bag, source.strict) as bag:
        part = BagPart(bag.resolve_cloud_topic(source.topic), sensor_frame=source.sensor_frame)
        return choose_from(first_scans(bag, part, FIRST_SCANS))


def _opened(
    sources: Sequence[Dataset | BagSource], settings: Settings, num: tuple[int, int], folder: Path
) -> list[tuple[Dataset, Config]]:
    """All as data sets; pairs of bags are chosen, at most `num` and so many negatives, their scans go to `folder`."""
    from svc_ros.evaluation.bag_pairs import BagSource, dataset_of_bag

    sets = []
    for k, source in enumerate(sources):
        if isinstance(source, BagSource):
            (folder / str(k)).mkdir()
            with working(f"choosing pairs of {source.bag.name}"):
                made = dataset_of_bag(source, settings.base, settings.config, num, folder / str(k))
            warn_of_damage(made.damage)
            source = made
        sets.append((source, settings.config))
    return sets


def _ranges(sets: Sequence[tuple[Dataset, Config]]) -> str:
    """The data sets whose ranges are not those of the configuration; the value belongs to theirs."""
    limits = sets[0][1].preprocess
    own = (limits.min_range_m, limits.max_range_m)
    others = [d for d, _ in sets if (d.min_range_m, d.max_range_m) != own]
    return ", ".join(f"{d.name} {d.min_range_m:g} to {d.max_range_m:g} m" for d in others)


def _show(console: Console, summary: dict[str, Any]) -> None:
    from svc_ros.evaluation.calibration.page import border_rows, count_rows
    from svc_ros.evaluation.calibration.summary import statement

    names = ", ".join(one["dataset"] for one in summary["datasets"])
    chosen = summary.get("chosen_preset")
    which = f": {chosen['preset']}" if chosen else ""
    head, *rows = border_rows(summary)
    table = Table(*head, title=Text(f"{names}: preset {summary['preset']}{which}"), title_justify="left")
    for row in rows:
        table.add_row(*map(Text, row))
    console.print(table)
    console.print(key_value_table("judged", {row[0]: row[1] for row in count_rows(summary)}))
    console.print(Text(statement(summary)), soft_wrap=True)


def _write(out: Path, summary: dict[str, Any], settings: Settings, how: tuple[bool, bool, str]) -> None:
    """how: whether a page is wanted, whether a value that keeps no promise is, and ranges that are not the config's."""
    from svc_ros.evaluation.calibration.run import calibrated_yaml
    from svc_ros.evaluation.calibration.summary import statement

    page, best_effort, ranges = how
    write_json(summary, str(out / "calibration.json"))
    if page:
        from svc_ros.evaluation.calibration.page import write_calibration_page

        write_calibration_page(out / "calibration.html", summary)
    if summary["chosen"] or best_effort:
        names = ", ".join(one["dataset"] for one in summary["datasets"])
        lines = [f"svc_ros calibrate on {names}", statement(summary)]
        lines += [f"Judged with the ranges of the data: {ranges}"] if ranges else []
        comment = "\n".join(textwrap.fill(line, 116) for line in lines)
        text = calibrated_yaml(summary, settings.base, settings.config, comment)
        (out / "calibration.yaml").write_text(text, encoding="utf-8")
    else:
        (out / "calibration.yaml").unlink(missing_ok=True)  # of an earlier run, which these data do not bear out
        note(f"no {out / 'calibration.yaml'}: the data cannot keep the promise; --best-effort writes the surest value")
