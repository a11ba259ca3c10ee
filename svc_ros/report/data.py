"""What a run left in its folder, as far as it is there, and which of its decisions a page shows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.core.config import Config, preset
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, Verdict
from svc_ros.io.config_yaml import read_config
from svc_ros.io.results import read_jsonl
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.report.reasons import REASON_TEXTS, VERDICT_TEXTS
from svc_ros.report.sight_lines import choose_evenly

MAX_BINS = 200  # of the strip that shows the order of verdicts
MAX_DRAWN = 3000  # decisions in the plots: what a phone still draws at once
_WAYS = ("source_in_target", "target_in_source")

Record = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Run:
    """The folder of a replay. records: one a decision, with the last word on it; notes: what is missing, as sentences;
    optimized: the way after the loops, where it was computed; config: None where the folder has none."""

    records: Sequence[Record] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)
    trajectory: Trajectory | None = None
    optimized: Trajectory | None = None
    config: Config | None = None
    notes: Sequence[str] = ()


def read_run(folder: Path) -> Run:
    """Read what there is; a file that is absent becomes a note, a file that is broken an InputError."""
    notes: list[str] = []

    def there(name: str, lost: str) -> Path | None:
        if (folder / name).is_file():
            return folder / name
        notes.append(f"{name} is not in the folder: {lost}.")
        return None

    decisions = there("decisions.jsonl", "there are no decisions to show")
    summary = there("summary.json", "the page cannot tell what was replayed")
    trajectory = there("trajectory_tum.txt", "the way is drawn from the reference or from accepted pairs, if at all")
    optimized = folder / "trajectory_optimized_tum.txt"
    config = there("config.yaml", "the borders of the decision are those of the default preset")
    told = {} if summary is None else _read_json(summary)
    notes += [f"Damaged: {damage['message']}." for damage in told.get("damage", ())]
    return Run(
        [] if decisions is None else _last_words(read_jsonl(decisions)),
        told,
        None if trajectory is None or not trajectory.stat().st_size else read_tum(trajectory),
        read_tum(optimized) if optimized.is_file() and optimized.stat().st_size else None,
        None if config is None else read_config(config, preset("lidar_outdoor")),
        notes,
    )


def _last_words(records: Iterable[Record]) -> list[Record]:
    """One record a decision; a later word on an earlier pair stands in its place, with the evidence of the first."""
    last: list[Record] = []
    number: dict[tuple[Any, Any], int] = {}
    for record in records:
        pair = record.get("source_stamp_ns"), record.get("target_stamp_ns")
        if record.get("origin") == "agreement" and pair in number:
            first = last[number[pair]]
            last[number[pair]] = {**record, "evidence": first.get("evidence"), "origin": first.get("origin")}
        else:
            number[pair] = len(last)
            last.append(record)
    return last


def _read_json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: expected a JSON object: {error}") from None
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(value).__name__}")
    return value


def verdict_of(record: Record) -> Verdict:
    """The record's verdict; InputError for one that there is not."""
    try:
        return Verdict(record.get("verdict"))
    except ValueError:
        raise InputError(f"decision: expected a verdict, found {record.get('verdict')!r:.40}") from None


def words_of(record: Record) -> str:
    """The reason in words; of a code that this version does not know, the code itself."""
    code = str(record.get("reason", ""))
    if code == Reason.OK.value:
        return VERDICT_TEXTS[Verdict.ACCEPTED]
    return REASON_TEXTS[Reason(code)].meaning if code in {reason.value for reason in Reason} else code


def overlap_of(record: Record) -> float | None:
    """Oriented overlap in [0, 1]; None where nothing was judged."""
    value = (record.get("evidence") or {}).get("oriented_overlap_ratio")
    return None if value is None else float(value)


def denied_of(record: Record) -> float | None:
    """Denied share of the surface that either sensor could see, in [0, 1].

    None where neither looked: nothing was judged, by another method, or by a version that knew no denied surface.
    """
    evidence = record.get("evidence") or {}
    value = evidence.get("denied_ratio")
    is_seen = any(evidence.get(f"num_points_{way}", 1) for way in _WAYS)
    return float(value) if value is not None and is_seen else None


def choose_drawn(records: Sequence[Record], wanted: Iterable[int], max_drawn: int = MAX_DRAWN) -> list[int]:
    """Lines of the decisions that plots show: all if they are few, else `wanted` ones and an even choice.

    What was not accepted has the first claim on two thirds of the places.
    """
    if len(records) <= max_drawn:
        return list(range(len(records)))
    accepted = np.array([verdict_of(record) is Verdict.ACCEPTED for record in records])
    rare = choose_evenly(np.flatnonzero(~accepted), 2 * max_drawn // 3)
    common = choose_evenly(np.flatnonzero(accepted), max_drawn - len(rare))
    return sorted({*rare.tolist(), *common.tolist(), *wanted})


def decision_columns(records: Sequence[Record], drawn: Sequence[int]) -> dict[str, list[Any]]:
    """The drawn decisions, one list a quantity; `time_s` counts from the run's first stamp."""
    stamps = [int(record.get("source_stamp_ns") or 0) for record in records]
    first = min((stamp for stamp in stamps if stamp), default=0)
    rows = [
        {
            "line": k,
            "time_s": round(1e-9 * (stamps[k] - first), 3) if stamps[k] else None,
            "verdict": verdict_of(records[k]).value,
            "reason": str(records[k].get("reason", "")),
            "probability": _rounded(records[k].get("probability"), 4),
            "overlap": _rounded(overlap_of(records[k]), 4),
            "denied": _rounded(denied_of(records[k]), 5),
        }
        for k in drawn
    ]
    names = ("line", "time_s", "verdict", "reason", "probability", "overlap", "denied")
    return {name: [row[name] for row in rows] for name in names}


def verdict_strip(records: Sequence[Record]) -> dict[str, Any]:
    """How many decisions of each verdict fall into each of at most MAX_BINS equal parts of the run; all are counted.

    The run is measured in seconds since its first stamp, or in decisions where not every one has a stamp.
    """
    stamps = np.array([int(record.get("source_stamp_ns") or 0) for record in records], np.int64)
    is_timed = len(stamps) > 0 and bool(stamps.min() > 0) and bool(np.ptp(stamps) > 0)
    places = 1e-9 * (stamps - stamps.min()) if is_timed else np.arange(len(records), dtype=np.float64)
    num_bins = max(1, min(MAX_BINS, len(records)))
    edges = np.linspace(0.0, float(places.max(initial=0.0)) or 1.0, num_bins + 1)
    verdicts = np.array([verdict_of(record).value for record in records])
    counts = {v.value: np.histogram(places[verdicts == v.value], edges)[0].tolist() for v in Verdict}
    return {"start": edges[:-1].round(3).tolist(), "width": round(float(edges[1]), 4), "counts": counts}


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(float(value), digits)


def worst_decisions(records: Sequence[Record], num_each: int = 5) -> list[tuple[int, str]]:
    """Lines of decisions that deserve a look, each with why; the most alarming first, none twice."""
    judged = [k for k, record in enumerate(records) if record.get("probability") is not None]
    accepted = [k for k in judged if verdict_of(records[k]) is Verdict.ACCEPTED]
    others = [k for k in judged if verdict_of(records[k]) in (Verdict.REJECTED, Verdict.UNDECIDED)]
    failed = [k for k, record in enumerate(records) if record.get("probability") is None
              and verdict_of(record) is Verdict.REJECTED]  # fmt: skip
    with_error = [k for k in accepted if records[k].get("translation_error_m") is not None]
    kinds = [
        ("accepted, farthest from the reference", with_error, lambda k: -records[k]["translation_error_m"]),
        ("accepted, least sure", accepted, lambda k: records[k]["probability"]),
        ("not accepted, nearest to acceptance", others, lambda k: -records[k]["probability"]),
        ("not accepted, most denied", others, lambda k: -(denied_of(records[k]) or 0.0)),
        ("could not be registered", failed, lambda k: k),
    ]
    found: dict[int, str] = {}
    for why, lines, order in kinds:
        fresh = [k for k in sorted(lines, key=order) if k not in found]
        found |= dict.fromkeys(fresh[:num_each], why)
    return list(found.items())
