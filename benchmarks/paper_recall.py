"""Tables 1 to 3 of the paper: registration recall and errors of SC2-PCR, of the published rule, and of svc.

    python benchmarks/paper_recall.py [--data DIR] [--limit N] [--3dmatch DIR] [--3dlomatch DIR] [--kitti DIR]

Without whole benchmarks the sets of the data folder stand in their columns: 3DMatch fragments of the red kitchen, and
KITTI pairs with FPFH of this package and with correspondences that others computed. A recall is the share of pairs
whose best candidate is right, whatever the verdict, as in the paper. Writes paper-recall.json and paper-recall.png.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import config_of, console, describe_run, parse_options, print_table, write_report
from lib.figures import new_bars, write_figure
from lib.paper import METHODS, PUBLISHED, Column, add_benchmarks, choose_pairs, read_columns
from rich.progress import Progress

from svc_ros.core.config import with_values
from svc_ros.evaluation.runner import evaluate_datasets
from svc_ros.evaluation.suite_recall import is_right
from svc_ros.io.suites import Criterion

HEAD = ("column", "method", "pairs", "RR [%]", "RE [deg]", "TE [cm]", "accepted and right [%]", "false accepts",
        "published RR [%]", "RE [deg]", "TE [cm]")  # fmt: skip
NUMBERS = ("recall_percent", "rotation_error_deg", "translation_error_cm")
Table = dict[str, dict[str, dict[str, Any]]]


def main() -> None:
    """Run, print, write."""
    options = parse_options("Registration recall: tables 1 to 3 of the paper.", extend)
    columns = read_columns(options)
    run = describe_run([column.dataset for column in columns])
    chosen = [dataclasses.replace(c.dataset, pairs=choose_pairs(c.dataset, options.limit)) for c in columns]
    sets = [
        (dataclasses.replace(dataset, negatives=[], candidates=[]), with_values(config_of(dataset), {"method": method}))
        for dataset in chosen
        for method in METHODS
    ]
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("pairs", total=None)
        reports = evaluate_datasets(
            sets, None, options.workers, lambda done, total: bar.update(task, completed=done, total=total)
        )
    table = tabulate(columns, reports)
    print_table("Tables 1 to 3", HEAD, rows_of(table))
    draw(table, options.out / "paper-recall.png")
    numbers = {column.title: column.table for column in columns}
    values = {"table_of": numbers, "limit": options.limit, "recall": table, "published": PUBLISHED}
    write_report(options.out / "paper-recall.json", values, run)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    add_benchmarks(parser)
    parser.add_argument("--limit", type=int, default=6, metavar="N", help="pairs of each column, evenly over overlap")


def tabulate(columns: Sequence[Column], reports: Sequence[Mapping[str, Any]]) -> Table:
    """Numbers by column and method; reports in the order of both."""
    found = iter(reports)
    return {column.title: {method: summarise(column, next(found)) for method in METHODS} for column in columns}


def summarise(column: Column, report: Mapping[str, Any]) -> dict[str, Any]:
    """Recall [%] by best candidate, mean errors over the right ones, and what was accepted."""
    success, numbers = column.dataset.success, report["registration"]
    bounds = Criterion("", success.rotation_deg, success.translation_m)
    right = [row for row in numbers["pairs"] if is_right(bounds, row)]
    published = PUBLISHED[column.published].get(report["method"], (None, None, None))
    return {
        "num_pairs": numbers["num_pairs"],
        "recall_percent": _percent(len(right), numbers["num_pairs"]),
        "rotation_error_deg": _mean([row["rotation_error_deg"] for row in right]),
        "translation_error_cm": _mean([100.0 * row["translation_error_m"] for row in right]),
        "accepted_and_right_percent": _percent(numbers["num_correct_accepted"], numbers["num_pairs"]),
        "num_false_accepted": numbers["num_false_accepted"],
        "published": dict(zip(NUMBERS, published, strict=True)),
        "recall_by_definition": report.get("recall"),
    }


def rows_of(table: Table) -> list[list[Any]]:
    """Lines to print."""
    plain = ("num_pairs", *NUMBERS, "accepted_and_right_percent", "num_false_accepted")
    return [
        [title, method, *(values[name] for name in plain), *values["published"].values()]
        for title, of_column in table.items()
        for method, values in of_column.items()
    ]


def draw(table: Table, path: Path) -> None:
    """Recall by column, a bar a method; a line across a bar is what the paper reports on the whole benchmark."""
    bars = [
        {m: (of[m]["recall_percent"] or 0.0, of[m]["published"]["recall_percent"]) for m in METHODS}
        for of in table.values()
    ]
    numbers = [of[METHODS[0]]["num_pairs"] for of in table.values()]
    labels = [f"{title.replace(': ', chr(10))}\n{num} pairs" for title, num in zip(table, numbers, strict=True)]
    title = "Tables 1 to 3; black lines: the paper, on the whole benchmark"
    told = {"ylim": (0.0, 105.0), "ylabel": "registration recall [%]", "title": title}
    write_figure(new_bars(labels, METHODS, bars, 2.6, **told), path)


def _percent(part: int, whole: int) -> float | None:
    return 100.0 * part / whole if whole else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


if __name__ == "__main__":
    main()
