"""How fast is a registration from raw points to the verdict, beside KISS-Matcher and Open3D's RANSAC?

    python benchmarks/compare.py [--limit N] [--rounds N] [--data DIR] [--out DIR]

Every method gets the same raw points of the same real pairs, in turns. It is first asked once and its answer compared
with the reference pose, then timed. Writes the sections `register`, `verify`, `kiss_matcher`, `open3d_ransac` and
`compare` of latest.json, and compare.png.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lib.cases import choose_sets
from lib.common import Dataset, console, describe_run, parse_options, print_table, read_datasets
from lib.contenders import CONTENDERS, Call, RawPair, missing
from lib.figures import new_figure, write_figure
from lib.latest import record
from lib.pairs import choose
from lib.timing import rotated, time_once_ms
from rich.console import Console
from rich.progress import track

from svc_ros.evaluation.metrics import PairOutcome, judge_pose
from svc_ros.io.datasets import Pair

ALL = "all"
ASKED_ONCE = ("open3d_ransac",)
PEAK_OF = ("register", "verify", "kiss_matcher", "open3d_ransac")
RIVALS = ("kiss_matcher", "open3d_ransac")
HEAD = ("method", "pairs", "accepted and right", "p50 [ms]", "x KISS-Matcher", "x svc_ros", "peak [MB]")


@dataclass(frozen=True)
class Row:
    """What one method made of one pair, and its median time."""

    dataset: str
    source: str
    target: str
    method: str
    outcome: PairOutcome
    time_ms: float

    @property
    def right(self) -> bool:
        """The method stands by its pose, and it is within the set's bounds."""
        return self.outcome.accepted and self.outcome.correct


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--limit", type=int, default=4, help="pairs a set, evenly over its overlaps")
        parser.add_argument("--rounds", type=int, default=2, help="times that every method is timed on every pair")

    options = parse_options("Compare whole registrations from raw points.", extend, workers=False)
    skipped = dict(missing())
    for name, reason in skipped.items():
        console.print(f"{name} is left out: {reason}")
    methods = [name for name in CONTENDERS if name not in skipped]
    datasets = choose_sets(read_datasets(options.data))
    run = describe_run(datasets)
    chosen = alternate(datasets, options.limit)
    bar = track(chosen, "pairs", console=Console(stderr=True), transient=True)
    rows = [row for turn, (dataset, pair) in enumerate(bar)
            for row in run_pair(RawPair.read(dataset, pair), methods, options.rounds, turn)]  # fmt: skip
    sections = summarise(rows, methods, {name: peaks(name, datasets) for name in methods if name in PEAK_OF})
    show(sections, methods)
    draw(sections, methods, options.out / "compare.png")
    details = {"limit": options.limit, "rounds": options.rounds, "skipped": skipped, "pairs": [flat(r) for r in rows]}
    record(options.out, "compare", run, {**public_sections(sections), "compare": details})


def alternate(datasets: Sequence[Dataset], limit: int) -> list[tuple[Dataset, Pair]]:
    """The pairs of all sets, one set after the other: a slow minute of the machine hits all of them."""
    chosen = ([(dataset, pair) for pair in choose(dataset, limit) if pair.T_target_source is not None]
              for dataset in datasets)  # fmt: skip
    return [item for turn in itertools.zip_longest(*chosen) for item in turn if item is not None]


def run_pair(raw: RawPair, methods: Sequence[str], rounds: int, turn: int) -> list[Row]:
    """Every method once for its answer, then in turns for its time; each round and pair begins with another one.

    The slow ones (`ASKED_ONCE`) are not asked again: the time of their answer counts.
    """
    calls: dict[str, Call] = {name: CONTENDERS[name](raw) for name in methods}
    outcomes, times = {}, {}
    for name in rotated(list(methods), turn):
        start = time.perf_counter()
        outcomes[name] = judge(raw, calls[name])
        times[name] = [1e3 * (time.perf_counter() - start)]
    quick = [name for name in methods if name not in ASKED_ONCE]
    times |= {name: [] for name in quick}
    for k in range(rounds):
        for name in rotated(quick, turn + k):
            times[name].append(time_once_ms(calls[name]))
    where = (raw.dataset.name, raw.pair.source, raw.pair.target)
    return [Row(*where, name, outcomes[name], float(np.median(times[name]))) for name in methods]


def judge(raw: RawPair, call: Call) -> PairOutcome:
    """The answer beside the reference pose."""
    answer = call()
    return judge_pose(answer.T_target_source, raw.pair.T_target_source, raw.dataset.success, answer.accepted)


def peaks(method: str, datasets: Sequence[Dataset]) -> dict[str, Any]:
    """Megabytes of a method at most, and before its packages were loaded, in a process of its own, by set."""
    found = {}
    for dataset in datasets:
        command = [sys.executable, "-m", "lib.peak", method, str(dataset.root.resolve())]
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{' '.join(command)}: ended with {done.returncode}\n{done.stderr}")
        found[dataset.name] = json.loads(done.stdout.splitlines()[-1])
    return found


def summarise(
    rows: Sequence[Row], methods: Sequence[str], memory: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Per method: recall, median time, ratios to the other methods' times, memory, and the same by set."""
    names = list(dict.fromkeys(row.dataset for row in rows))
    sections = {}
    for method in methods:
        by_set = {name: numbers(_of(rows, name), method, methods) for name in names}
        sections[method] = {**numbers(rows, method, methods), "by_set": by_set}
        if method in memory:
            peak = max(values["peak_mb"] for values in memory[method].values())
            sections[method] |= {"peak_mb": peak, "memory": memory[method]}
    return sections


def numbers(rows: Sequence[Row], method: str, methods: Sequence[str]) -> dict[str, Any]:
    """One method on some pairs. A ratio is the median over the pairs of that pair's ratio."""
    own = {(r.dataset, r.source, r.target): r for r in rows if r.method == method}
    values = {"pairs": len(own), "recall": _share(own.values(), lambda r: r.right),
              "candidate_recall": _share(own.values(), lambda r: r.outcome.correct),
              "time_ms_p50": float(np.median([r.time_ms for r in own.values()]))}  # fmt: skip
    for other in methods:
        theirs = {(r.dataset, r.source, r.target): r for r in rows if r.method == other}
        values[f"ratio_vs_{other}"] = float(np.median([own[key].time_ms / theirs[key].time_ms for key in own]))
    return values


def public_sections(sections: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What stands in latest.json: the variants of register and verify are told in the section of the plain form."""
    reused, first = sections["register_reused"], sections["verify_first"]
    register = {**sections["register"], "reused": reused}
    for rival in RIVALS:
        if f"ratio_vs_{rival}" in reused:
            register[f"ratio_vs_{rival}_reused"] = reused[f"ratio_vs_{rival}"]
    verify = {**sections["verify"], "ratio_vs_register_first": first["ratio_vs_register"], "first": first}
    return {"register": register, "verify": verify,
            **{rival: dict(sections[rival]) for rival in RIVALS if rival in sections}}  # fmt: skip


def show(sections: Mapping[str, Mapping[str, Any]], methods: Sequence[str]) -> None:
    """A table of all pairs, and one a set."""
    for name in (ALL, *sections[methods[0]]["by_set"]):
        rows = []
        for method in methods:
            values = sections[method] if name == ALL else sections[method]["by_set"][name]
            ratios = values.get("ratio_vs_kiss_matcher"), values["ratio_vs_register"]
            rows.append(
                (method, values["pairs"], values["recall"], values["time_ms_p50"], *ratios, values.get("peak_mb"))
            )
        print_table(f"{name}: from raw points to the answer", HEAD, rows)


def flat(row: Row) -> dict[str, Any]:
    """A row for the JSON file."""
    outcome = row.outcome
    return {
        "dataset": row.dataset, "source": row.source, "target": row.target, "method": row.method,
        "accepted": outcome.accepted, "correct": outcome.correct, "time_ms": round(row.time_ms, 1),
        "rotation_error_deg": outcome.rotation_error_deg, "translation_error_m": outcome.translation_error_m,
    }  # fmt: skip


def draw(sections: Mapping[str, Mapping[str, Any]], methods: Sequence[str], path: Path) -> None:
    """Median times by set, a group of bars for each method."""
    figure = new_figure(10.0, 4.0)
    axes = figure.add_subplot()
    names = list(sections[methods[0]]["by_set"])
    width = 0.8 / len(names)
    for k, name in enumerate(names):
        times = [sections[method]["by_set"][name]["time_ms_p50"] for method in methods]
        bars = axes.bar(np.arange(len(methods)) + k * width, times, width, label=name)
        axes.bar_label(bars, [f"{time:.0f}" for time in times], fontsize=8)
    axes.set_xticks(np.arange(len(methods)) + 0.5 * width * (len(names) - 1), methods)
    axes.set(yscale="log", ylabel="median time of a pair [ms]", title="From raw points to the answer")
    axes.legend(frameon=False)
    write_figure(figure, path)


def _of(rows: Sequence[Row], dataset: str) -> list[Row]:
    return [row for row in rows if row.dataset == dataset]


def _share(rows: Any, test: Callable[[Row], bool]) -> float:
    return float(np.mean([test(row) for row in rows]))


if __name__ == "__main__":
    main()
