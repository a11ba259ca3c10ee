"""How often is the pose found? svc_ros, its ablations and other packages on pairs of scans.

    python benchmarks/registration.py [--limit N] [--methods NAME ...] [--data DIR] [--out DIR]

Writes registration.json and registration.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from _attempts import CHANGES, METHODS, Attempt, method_of, why_not
from _common import (
    Dataset,
    config_of,
    console,
    describe_run,
    parse_options,
    print_table,
    read_datasets,
    spread,
    write_report,
)

from svc_ros.core.config import Config
from svc_ros.core.registration import extract_features
from svc_ros.core.scan import Features
from svc_ros.evaluation.metrics import PairOutcome, judge_pose, percentile, registration_metrics
from svc_ros.io.datasets import Pair

BINS = (("< 0.3", 0.0, 0.3), ("0.3-0.5", 0.3, 0.5), ("0.5-0.7", 0.5, 0.7), ("> 0.7", 0.7, 1.01))
HEAD = ("method", "pairs", "right candidate", "accepted and right", "false accepts", *(f"overlap {b[0]}" for b in BINS),
        "p50 [ms]")  # fmt: skip
ALL = "all sets"
_MORE = {"os0_64_walk": 3}  # the set with the widest spread of overlap gets so many times the limit


@dataclass(frozen=True)
class Job:
    """One pair of a data set, and the methods that are to register it."""

    dataset: Dataset
    pair: Pair
    methods: tuple[str, ...]


@dataclass(frozen=True)
class Row:
    """What one method made of one pair; overlap is None for a pair without any alignment."""

    dataset: str
    source: str
    target: str
    overlap: float | None
    method: str
    outcome: PairOutcome
    time_ms: float


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--limit", type=int, default=6, help="pairs a set, evenly over its overlaps (walk: thrice)")
        parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, metavar="NAME", help="see README")

    options = parse_options("Compare registration methods on pairs of scans.", extend)
    skipped = {name: reason for name in options.methods if (reason := why_not(name)) is not None}
    for name, reason in skipped.items():
        console.print(f"{name} is left out: {reason}")
    methods = tuple(name for name in options.methods if name not in skipped)
    datasets = read_datasets(options.data)
    run = describe_run(datasets)
    jobs = [Job(d, pair, methods) for d in datasets for pair in choose(d, options.limit)]
    rows = [row for of_pair in spread(register_all, jobs, options.workers, "pairs") for row in of_pair]
    tables = tabulate(rows, methods)
    for name, table in tables.items():
        print_table(name, HEAD, [cells(method, values) for method, values in table.items()])
    draw(tables[ALL], options.out / "registration.png")
    values = {"limit": options.limit, "skipped": skipped, "changes": CHANGES, "registration": tables,
              "pairs": [flat(row) for row in rows]}  # fmt: skip
    write_report(options.out / "registration.json", values, run)


def choose(dataset: Dataset, limit: int) -> list[Pair]:
    """At most `limit` pairs, evenly over the pairs in order of overlap, and as many negatives."""
    by_overlap = sorted(dataset.pairs, key=lambda pair: pair.overlap or 0.0)
    return _evenly(by_overlap, limit * _MORE.get(dataset.name, 1)) + _evenly(dataset.negatives, limit)


def _evenly(pairs: Sequence[Pair], limit: int) -> list[Pair]:
    places = np.unique(np.linspace(0, len(pairs) - 1, min(limit, len(pairs))).round().astype(int))
    return [pairs[k] for k in places] if len(pairs) else []


_described: dict[tuple[Any, ...], Features] = {}


def describe(dataset: Dataset, path: str, config: Config) -> Features:
    """The scan's descriptors, kept for the next pair and for every method that shares these settings."""
    key = (dataset.name, path, config.preprocess, config.features)
    if key not in _described:
        if len(_described) > 40:
            _described.pop(next(iter(_described)))
        _described[key] = extract_features(dataset.read_scan(path), config)
    return _described[key]


def register_all(job: Job) -> list[Row]:
    """One pair by every method; a configuration that is the same as svc's in this set is not run twice."""
    known: dict[Any, Attempt] = {}
    rows = []
    for name in job.methods:
        method, config = method_of(name, config_of(job.dataset))
        if (method, config) not in known:
            source, target = (describe(job.dataset, path, config) for path in (job.pair.source, job.pair.target))
            known[method, config] = method(source, target, config)
        attempt = known[method, config]
        rows.append(Row(job.dataset.name, job.pair.source, job.pair.target, job.pair.overlap, name,
                        judge(job, attempt), attempt.time_ms))  # fmt: skip
    return rows


def judge(job: Job, attempt: Attempt) -> PairOutcome:
    """Right only where there is something to be found, and where it was found."""
    if job.pair.T_target_source is None:
        return PairOutcome(attempt.accepted, correct=False)
    return judge_pose(attempt.T_target_source, job.pair.T_target_source, job.dataset.success, attempt.accepted)


def tabulate(rows: Sequence[Row], methods: Sequence[str]) -> dict[str, dict[str, dict[str, Any]]]:
    """Metrics by set and method; `all sets` pools the pairs that have a reference."""
    names = list(dict.fromkeys(row.dataset for row in rows))
    tables = {}
    for name in [*names, ALL]:
        chosen = [r for r in rows if r.dataset == name or (name == ALL and r.overlap is not None)]
        tables[name] = {method: summarise([r for r in chosen if r.method == method]) for method in methods}
    return tables


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Metrics of one method, and its right candidates by overlap: [right, pairs]."""
    by_overlap = {}
    for name, low, high in BINS:
        inside = [r.outcome.correct for r in rows if r.overlap is not None and low <= r.overlap < high]
        by_overlap[name] = [sum(inside), len(inside)]
    times = percentile((r.time_ms for r in rows), 50)
    return {**registration_metrics([r.outcome for r in rows]), "by_overlap": by_overlap, "time_ms_p50": times}


def cells(method: str, values: Mapping[str, Any]) -> list[Any]:
    """One line of a table."""
    shares = [f"{right}/{num}" if num else None for right, num in values["by_overlap"].values()]
    time_ms = values["time_ms_p50"]
    return [method, values["num_pairs"], values["candidate_success_rate"], values["success_rate"],
            values["num_false_accepted"], *shares, None if time_ms is None else round(time_ms)]  # fmt: skip


def flat(row: Row) -> dict[str, Any]:
    """A row for the JSON file."""
    outcome = row.outcome
    return {
        "dataset": row.dataset, "source": row.source, "target": row.target, "overlap": row.overlap,
        "method": row.method, "accepted": outcome.accepted, "correct": outcome.correct,
        "rotation_error_deg": outcome.rotation_error_deg, "translation_error_m": outcome.translation_error_m,
        "time_ms": round(row.time_ms, 1),
    }  # fmt: skip


def draw(table: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Right candidates by overlap, a group of bars for each bin."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    width = 0.85 / len(table)
    for k, (method, values) in enumerate(table.items()):
        shares = [right / num if num else 0.0 for right, num in values["by_overlap"].values()]
        axes.bar(
            np.arange(len(BINS)) + (k - 0.5 * (len(table) - 1)) * width,
            shares,
            width,
            label=method,
            color=colormaps["tab20"](k),
        )
    numbers = [num for _, num in next(iter(table.values()))["by_overlap"].values()]
    axes.set_xticks(range(len(BINS)), [f"{b[0]} ({n} pairs)" for b, n in zip(BINS, numbers, strict=True)])
    axes.set(ylim=(0.0, 1.05), xlabel="overlap", ylabel="share of pairs with the right candidate", title="All sets")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)
    console.print(f"wrote {path}")


if __name__ == "__main__":
    main()
