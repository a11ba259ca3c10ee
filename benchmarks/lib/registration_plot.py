"""The picture of whole registrations: what each method accepts rightly and wrongly, by overlap and by sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from lib.figures import new_figure, write_figure
from lib.tally import Row, by_overlap, count, grouped, methods_of, of_method

Counts = Mapping[str, Mapping[str, int]]


def draw(rows: Sequence[Row], path: Path) -> None:
    """A group of bars for each bin of overlap, and below for each kind of sensor; a colour for each method."""
    methods = methods_of(rows)
    sensors = grouped((row for row in rows if not row["negative"]), "sensor")
    figure = new_figure(13.0, 8.5)
    above, below = figure.subplots(2, 1)
    draw_groups(above, {method: by_overlap(of_method(rows, method)) for method in methods})
    draw_groups(below, {m: {name: count(of_method(r, m)) for name, r in sensors.items()} for m in methods})
    title = "Upwards: accepted and right (pale: right, not accepted). Downwards: accepted and wrong"
    above.set(xlabel="overlap", title=title)
    below.set(xlabel="sensor")
    above.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9, frameon=False)
    write_figure(figure, path, dpi=110)


def draw_groups(axes: Any, tables: Mapping[str, Counts]) -> None:
    """Shares of the pairs of each group, a bar for each method; false accepts downwards with their number."""
    from matplotlib import colormaps

    groups = [name for name, counts in next(iter(tables.values())).items() if counts["num_pairs"]]
    width, lowest = 0.85 / len(tables), 0.0
    for k, (method, counts) in enumerate(tables.items()):
        inside = [counts[name] for name in groups]
        x = np.arange(len(groups)) + (k - 0.5 * (len(tables) - 1)) * width
        right, accepted, wrong = (
            np.array([c[key] / c["num_pairs"] for c in inside])
            for key in ("num_right", "num_accepted_right", "num_false_accepted")
        )
        colour = colormaps["tab20"](2 * k % 20)
        axes.bar(x, right, width, color=colour, alpha=0.25)
        axes.bar(x, accepted, width, color=colour, label=method)
        bars = axes.bar(x, -wrong, width, color=colour, hatch="////", edgecolor="black", linewidth=0.0)
        axes.bar_label(bars, [c["num_false_accepted"] or "" for c in inside], fontsize=8, padding=1)
        lowest = max(lowest, wrong.max(initial=0.0))
    numbers = [next(iter(tables.values()))[name]["num_pairs"] for name in groups]
    labels = [f"{fill(name, 16)}\n{num} pair{'s' * (num != 1)}" for name, num in zip(groups, numbers, strict=True)]
    axes.set_xticks(range(len(groups)), labels, fontsize=9)
    axes.set(ylim=(-max(lowest + 0.12, 0.2), 1.05), ylabel="share of pairs")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.grid(axis="y", alpha=0.3)
