"""How often is the pose found, and how often is a wrong one accepted? svc_ros and other packages, pair by pair.

    python benchmarks/registration.py [--limit N] [--methods NAME ...] [--data DIR] [--out DIR]

Every pair and every negative of every set, from raw points to the answer. Writes registration.json and
registration.png; `python benchmarks/tables.py` makes the tables of the pages from them.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lib.attempts import ACCEPTS, CHANGES, COMPARED, METHODS, PREPARED, method_of, why_not
from lib.common import (
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
from lib.pairs import choose
from lib.peers import Attempt
from lib.registration_plot import draw
from lib.sensors import kind_of
from lib.tally import BINS, NEGATIVES, tabulate

from svc_ros.evaluation.metrics import PairOutcome, judge_pose
from svc_ros.io.datasets import Pair

HEAD = ("method", "pairs", "right candidate", "accepted and right", "false accepts", "right above wrong",
        *(b[0] for b in BINS), NEGATIVES, "p50 [ms]", "p95 [ms]")  # fmt: skip


@dataclass(frozen=True)
class Job:
    """One pair of a data set, and the methods that are to register it."""

    dataset: Dataset
    pair: Pair
    methods: tuple[str, ...]


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--limit", type=int, help="pairs a set, evenly over its overlaps (walk: thrice)")
        parser.add_argument("--methods", nargs="+", choices=METHODS, default=COMPARED, metavar="NAME",
                            help="see README")  # fmt: skip

    options = parse_options("Compare registration methods on pairs of scans.", extend)
    skipped = {name: reason for name in options.methods if (reason := why_not(name)) is not None}
    for name, reason in skipped.items():
        console.print(f"{name} is left out: {reason}")
    methods = tuple(name for name in options.methods if name not in skipped)
    datasets = read_datasets(options.data)
    run = describe_run(datasets)
    jobs = [Job(d, pair, methods) for d in datasets for pair in choose(d, options.limit)]
    rows = [row for of_pair in spread(register_all, jobs, options.workers, "pairs") for row in of_pair]
    by_set, by_sensor = tabulate(rows, "dataset"), tabulate(rows, "sensor")
    for name, table in {**by_sensor, **by_set}.items():
        print_table(name, HEAD, [cells(method, values) for method, values in table.items()])
    draw(rows, options.out / "registration.png")
    told = {name: {"prepared": PREPARED[name], "accepts": ACCEPTS[name]} for name in methods}
    values = {"limit": options.limit, "workers": options.workers, "skipped": skipped, "methods": told,
              "changes": {name: change for name, change in CHANGES.items() if name in methods},
              "sensors": {d.name: d.sensor for d in datasets}, "registration": by_set, "by_sensor": by_sensor,
              "pairs": rows}  # fmt: skip
    write_report(options.out / "registration.json", values, run)


_asked: set[str] = set()  # by this process: what compiles and loads in a method's first call is no time of a pair


def register_all(job: Job) -> list[dict[str, Any]]:
    """One pair by every method; a configuration that is the same as svc's in this set is not run twice."""
    known: dict[Any, Attempt] = {}
    source, target = (job.dataset.read_scan(path) for path in (job.pair.source, job.pair.target))
    rows = []
    for name in job.methods:
        method, config = method_of(name, config_of(job.dataset))
        if name not in _asked:
            _asked.add(name)
            method(source, target, config)
        if (method, config) not in known:
            known[method, config] = method(source, target, config)
        rows.append(row_of(job, name, known[method, config]))
    return rows


def row_of(job: Job, method: str, attempt: Attempt) -> dict[str, Any]:
    """What one method made of one pair, for the JSON file."""
    outcome = judge(job, attempt)
    return {
        "dataset": job.dataset.name, "sensor": kind_of(job.dataset.sensor, job.dataset.name),
        "source": job.pair.source, "target": job.pair.target, "overlap": job.pair.overlap,
        "negative": job.pair.T_target_source is None, "method": method, "accepted": outcome.accepted,
        "correct": outcome.correct, "score": attempt.score, "rotation_error_deg": outcome.rotation_error_deg,
        "translation_error_m": outcome.translation_error_m, "total_ms": round(attempt.time_ms, 1),
    }  # fmt: skip


def judge(job: Job, attempt: Attempt) -> PairOutcome:
    """Right only where there is something to be found, and where it was found."""
    if job.pair.T_target_source is None:
        return PairOutcome(attempt.accepted, correct=False)
    return judge_pose(attempt.T_target_source, job.pair.T_target_source, job.dataset.success, attempt.accepted)


def cells(method: str, values: Mapping[str, Any]) -> Sequence[Any]:
    """One line of a table; a bin tells how many are accepted and right, of how many, and the false accepts."""
    bins = [
        f"{c['num_accepted_right']}/{c['num_pairs']} ({c['num_false_accepted']})" if c["num_pairs"] else None
        for c in values["by_overlap"].values()
    ]
    false_accepts = values["num_false_accepted"] + values["num_negatives_accepted"]
    times = [None if values[key] is None else round(values[key]) for key in ("time_ms_p50", "time_ms_p95")]
    return (method, values["num_pairs"] + values["num_negatives"], values["num_right"], values["num_accepted_right"],
            false_accepts, values["num_right_above_wrong"], *bins, *times)  # fmt: skip


if __name__ == "__main__":
    main()
