"""Figures 4b and 5 of the paper: time and registration recall against the number of hypotheses that are checked.

    python benchmarks/paper_hypotheses.py [--data DIR] [--limit N] [--3dmatch DIR] [--3dlomatch DIR] [--kitti DIR]

The published rule looks at up to K hypotheses; K = 0 is SC2-PCR alone. svc looks at up to K distinct poses, which it
refines first; its wide search at low overlap stays as configured. Time is that of a whole registration whose
descriptors are given. Times mean something only on a machine with nothing else to do; recalls always. Writes
paper-hypotheses.json and paper-hypotheses.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import config_of, describe_run, parse_options, print_table, spread, write_report
from lib.figures import new_figure, write_figure
from lib.paper import Column, add_benchmarks, choose_pairs, other_sets, read_columns, read_inputs

from svc_ros.core.config import with_values
from svc_ros.evaluation.metrics import PairOutcome, judge_pose
from svc_ros.io.datasets import Pair
from svc_ros.pipeline.decide import register_pair

PAPER, OURS = "svc_paper", "svc"
MORE = ("os0_64_walk",)  # the set with the widest spread of overlap
NUMBERS = {PAPER: (0, 1, 2, 5, 10, 20, 50, 100, 200), OURS: (1, 2, 4, 8, 16)}
Point = dict[str, float | int | None]
Table = dict[str, dict[str, list[Point]]]


def main() -> None:
    """Register with every number, print, write."""
    options = parse_options("Time and recall against hypotheses: figures 4b and 5.", extend, workers=False)
    columns = [column for column in read_columns(options) if len(column.dataset.pairs) > 1]
    columns += [Column(f"beyond the paper: {d.name}", "", d) for d in other_sets(options.data, MORE)]
    run = describe_run([column.dataset for column in columns])
    table = {column.title: measure(column, choose_pairs(column.dataset, options.limit)) for column in columns}
    for title, of_column in table.items():
        head = ("rule", "K", "pairs", "recall [%]", "accepted and right [%]", "mean time [ms]")
        print_table(title, head, [(rule, *point.values()) for rule, points in of_column.items() for point in points])
    draw(table, options.out / "paper-hypotheses.png")
    values = {"figure": "Figs. 4b and 5", "limit": options.limit, "hypotheses": table}
    write_report(options.out / "paper-hypotheses.json", values, run)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    add_benchmarks(parser)
    parser.add_argument("--limit", type=int, default=3, metavar="N", help="pairs of each column, evenly over overlap")


def measure(column: Column, pairs: Sequence[Pair]) -> dict[str, list[Point]]:
    """Recall and mean time by rule and K."""
    found = spread(lambda pair: register_with_all(column, pair), pairs, 1, column.title)
    return {
        rule: [summarise(num, [of_pair[rule, num] for of_pair in found]) for num in numbers]
        for rule, numbers in NUMBERS.items()
    }


def register_with_all(column: Column, pair: Pair) -> dict[tuple[str, int], tuple[PairOutcome, float]]:
    """One pair with every rule and K: what came out, and the time [ms]."""
    dataset, base = column.dataset, config_of(column.dataset)
    inputs = read_inputs(dataset, pair, base)
    for rule, numbers in NUMBERS.items():  # what is compiled or built on first use is not counted for the first K
        register_pair(*inputs[:2], with_values(base, changes_for(rule, numbers[1])), inputs[2])
    found = {}
    for rule, numbers in NUMBERS.items():
        for num in numbers:
            result = register_pair(*inputs[:2], with_values(base, changes_for(rule, num)), inputs[2])
            assert pair.T_target_source is not None
            outcome = judge_pose(result.best_candidate, pair.T_target_source, dataset.success, result.accepted)
            found[rule, num] = outcome, result.time_ms.get("total", 0.0)
    return found


def changes_for(rule: str, num: int) -> dict[str, Any]:
    """The configuration of a rule that looks at `num` hypotheses."""
    if rule == OURS:
        return {"method": OURS, "shortlist.max_poses": num}
    return {"method": PAPER, "paper.max_hypotheses": num} if num else {"method": "sc2"}


def summarise(num: int, results: Sequence[tuple[PairOutcome, float]]) -> Point:
    """One point of the curves."""
    outcomes = [outcome for outcome, _ in results]
    return {
        "hypotheses": num,
        "num_pairs": len(results),
        "recall_percent": _percent([outcome.correct for outcome in outcomes]),
        "accepted_and_right_percent": _percent([outcome.correct and outcome.accepted for outcome in outcomes]),
        "time_ms_mean": float(np.mean([time for _, time in results])) if results else None,
    }


def draw(table: Mapping[str, Mapping[str, Sequence[Point]]], path: Path) -> None:
    """Time on the left (Fig. 4b), recall on the right (Fig. 5)."""
    figure = new_figure(12.0, 4.8)
    panels = figure.subplots(1, 2)
    keys = (("time_ms_mean", "mean time [ms]", "Figure 4b"), ("recall_percent", "registration recall [%]", "Figure 5"))
    for axes, (key, label, title) in zip(panels, keys, strict=True):
        for k, (column, of_column) in enumerate(table.items()):
            for rule, points in of_column.items():
                style = "o-" if rule == PAPER else "s:"
                numbers, values = ([point[name] for point in points] for name in ("hypotheses", key))
                axes.plot(numbers, values, style, color=f"C{k}", label=f"{column}, {rule}")
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set(xlabel="hypotheses that are checked (0: SC2-PCR alone)", ylabel=label, title=title)
        axes.grid(alpha=0.3)
    panels[0].set_yscale("log")
    panels[1].set_ylim(0.0, 105.0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)
    write_figure(figure, path)


def _percent(flags: Sequence[bool]) -> float | None:
    return 100.0 * float(np.mean(flags)) if len(flags) else None


if __name__ == "__main__":
    main()
