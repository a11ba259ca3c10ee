"""Figure 4a and table 4 of the paper: the time of one sight-view check against the number of points.

    python benchmarks/paper_time.py [--data DIR] [--points N ...] [--rounds N]

One direction of one check, both scans with that many points, the target prepared: the published rule and that of svc,
each beside its twin on kd-trees, which must give the same answer first. Run it on a machine with nothing else to do.
Writes paper-time.json and paper-time.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from lib.cases import read_case
from lib.checks import OURS, PAPER, PAPER_TWIN, TWIN, compare_checks
from lib.common import describe_run, parse_options, print_table, write_report
from lib.figures import new_figure, write_figure
from lib.paper import other_sets
from lib.timing import exponent

SETS = ("rgbd_redkitchen", "hdl64_kitti_a", "os1_64_seosan")
POINTS = (2000, 4000, 6000, 8000, 10_000)
PUBLISHED_MS = {2000: 5.21, 4000: 6.97, 6000: 10.44, 8000: 13.09, 10_000: 16.28}  # Tab. 4: C++, kd-tree of PCL
NAMES = {PAPER: "svc_paper, as in svc_ros", PAPER_TWIN: "svc_paper, kd-trees", OURS: "svc", TWIN: "svc, kd-trees"}


def main() -> None:
    """Compare, time, print, write."""
    options = parse_options("Time of one check against points: figure 4a of the paper.", extend, workers=False)
    datasets = other_sets(options.data, SETS)
    run = describe_run(datasets)
    checks = compare_checks([read_case(d) for d in datasets], options.points, max(options.points), options.rounds)
    means = average(checks["curves"], options.points)
    rows = [(NAMES[name], *values["time_ms"], values["exponent"]) for name, values in means.items()]
    published = [PUBLISHED_MS.get(num) for num in options.points]
    head = ("one check, mean of all sets and poses [ms]", *map(str, options.points), "exponent")
    print_table("Figure 4a, table 4", head, [*rows, ("the paper, on its machine", *published, None)])
    draw(means, options.out / "paper-time.png")
    values = {"figure": "Fig. 4a, Tab. 4", "time_ms": means, "curves": checks["curves"], "published_ms": PUBLISHED_MS}
    write_report(options.out / "paper-time.json", values, run)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--points", type=int, nargs="+", default=POINTS, metavar="N", help="points of a scan")
    parser.add_argument("--rounds", type=int, default=5, help="times that every call is measured")


def average(curves: Mapping[str, Mapping[str, Any]], numbers: list[int]) -> dict[str, dict[str, Any]]:
    """Milliseconds by rule and number of points, the mean of all sets and poses; how they grow."""
    found = {}
    for name in NAMES:
        times = np.mean([curve["time_ms"][name] for curve in curves.values()], axis=0).tolist()
        found[name] = {"number": list(numbers), "time_ms": times, "exponent": exponent(numbers, times)}
    return found


def draw(means: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Time over points, linear axes as in the paper."""
    figure = new_figure(7.0, 4.5)
    axes = figure.add_subplot()
    for name, values in means.items():
        style = "s:" if name in (TWIN, PAPER_TWIN) else "o-"
        axes.plot(values["number"], values["time_ms"], style, label=NAMES[name])
    axes.plot(list(PUBLISHED_MS), list(PUBLISHED_MS.values()), "k--", label="the paper, on its machine (Tab. 4)")
    axes.set(xlabel="points of each scan", ylabel="time of one check [ms]", title="Figure 4a", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    write_figure(figure, path)


if __name__ == "__main__":
    main()
