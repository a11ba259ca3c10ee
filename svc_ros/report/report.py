"""A run as one HTML file that needs nothing else: verdicts, evidence, times, the way, and pairs in three dimensions."""

from __future__ import annotations

import html
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import svc_ros
from svc_ros.core.config import preset
from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.result import Verdict
from svc_ros.io.trajectories import Trajectory
from svc_ros.report.data import (
    Record,
    Run,
    choose_drawn,
    decision_columns,
    read_run,
    verdict_of,
    verdict_strip,
    words_of,
    worst_decisions,
)
from svc_ros.report.kept_scenes import scene_to_json
from svc_ros.report.plots import decision_border, map_from_above, stage_times
from svc_ros.report.reasons import REASON_TEXTS, VERDICT_TEXTS
from svc_ros.report.scenes import Scene

_SCRIPTS = ("data.js", "look.js", "plots.js", "view3d.js", "table.js", "page.js")


def write_report(path: Path, folder: Path, scenes: Sequence[Scene], reference: Trajectory | None = None) -> None:
    """Write what `svc_ros replay` left in `folder` as one page, with `scenes` of its decisions to look at.

    Reads decisions.jsonl, summary.json, trajectory_tum.txt and config.yaml; the page says which of them are absent.
    reference: drawn beside the trajectory, moved onto it. Raises InputError for a broken file or a scene of a decision
    that there is not, MissingDependencyError without plotly.
    """
    run = read_run(Path(folder))
    missing = [scene.index for scene in scenes if not 0 <= scene.index < len(run.records)]
    if missing:
        raise InputError(f"{folder}: expected decision {missing[0]} of a scene, found {len(run.records)} decisions")
    worst = worst_decisions(run.records)
    wanted = {*(scene.index for scene in scenes), *(line for line, _ in worst)}
    drawn = choose_drawn(run.records, wanted)
    told = sorted(wanted)
    page = {
        **_frame("report", run.records, {k: run.records[k] for k in told}, scenes),
        "title": _title(run, Path(folder)),
        "notes": list(run.notes),
        "summary": _flat(run.summary),
        "decisions": decision_columns(run.records, drawn),
        "strip": verdict_strip(run.records),
        "border": decision_border(run.config or preset("lidar_outdoor")),
        "times": stage_times(run.records),
        "map": map_from_above(run, reference, drawn),
        "worst": [{"line": line, "why": why} for line, why in worst],
    }
    write_page(Path(path), page)


def write_view(path: Path, record: Record, scene: Scene, title: str) -> None:
    """Write one pair, `record` being its decision as JSON, as a page with the view in three dimensions alone.

    Raises InputError where the page cannot be written, MissingDependencyError without plotly.
    """
    page = {**_frame("view", [record], {scene.index: record}, [scene]), "title": title, "notes": [], "summary": []}
    write_page(Path(path), page)


def _frame(kind: str, records: Sequence[Record], told: Mapping[int, Record], scenes: Sequence[Scene]) -> dict[str, Any]:
    """What both kinds of page hold; told: decisions whose numbers are listed, by line."""
    counts = Counter(verdict_of(record).value for record in records)
    return {
        "kind": kind,
        "version": svc_ros.__version__,
        "counts": {verdict.value: counts[verdict.value] for verdict in Verdict},
        "verdicts": {verdict.value: text for verdict, text in VERDICT_TEXTS.items()},
        "reasons": {reason.value: text._asdict() for reason, text in REASON_TEXTS.items()},
        "told": {str(line): _told(record) for line, record in told.items()},
        "scenes": [scene_to_json(scene) for scene in sorted(scenes, key=lambda scene: scene.index)],
    }


def _told(record: Record) -> dict[str, Any]:
    """A decision without what the page does not show."""
    left_out = ("covariance", "counts", "T_target_source", "weak_directions")
    return {key: value for key, value in record.items() if key not in left_out} | {"words": words_of(record)}


def _title(run: Run, folder: Path) -> str:
    for key in ("bag", "bags", "title"):
        value = run.summary.get(key)
        if value:
            names = [value] if isinstance(value, str) else [str(name) for name in value]
            return ", ".join("/".join(Path(name).parts[-2:]) for name in names)
    return folder.resolve().name


def _flat(values: Mapping[str, Any], above: str = "") -> list[list[Any]]:
    """Rows (name, value) of nested mappings, names joined by dots; lists as text."""
    rows: list[list[Any]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{above}{key}.")
        else:
            plain = value is None or isinstance(value, bool | int | float | str)
            rows.append([f"{above}{key}", value if plain else json.dumps(value)])
    return rows


def write_page(
    path: Path, data: Mapping[str, Any], page_name: str = "page.html", names: Sequence[str] = _SCRIPTS
) -> None:
    """Write `data`, which has a title, with a page of `page/`, scripts of these names and plotly, in one file.

    Raises InputError where it cannot be written, MissingDependencyError without plotly.
    """
    shell = resources.files("svc_ros.report") / "page"
    scripts = "\n".join((shell / name).read_text("utf-8") for name in names)
    parts = {
        "TITLE": html.escape(f"{data['title']} - svc_ros"),
        "STYLE": (shell / "style.css").read_text("utf-8"),
        "PLOTLY": _plotly(),
        "DATA": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "SCRIPTS": scripts,
    }
    pieces = (shell / page_name).read_text("utf-8").split("@@")  # text, name, text, name ... text
    page = "".join(parts[piece] if k % 2 else piece for k, piece in enumerate(pieces))
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _plotly() -> str:
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise MissingDependencyError("a report needs plotly: pip install plotly") from None
    return str(get_plotlyjs())
