"""Pictures of the benchmark scripts: an empty one, bars beside the paper's numbers, and how one is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lib.common import console

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> Figure:
    """An empty picture of that many inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def write_figure(figure: Figure, path: Path, dpi: int = 130) -> None:
    """Write it, and say so."""
    figure.savefig(path, dpi=dpi)
    console.print(f"wrote {path}")


def new_bars(
    labels: Sequence[str], rules: Sequence[str], bars: Sequence[Mapping[str, tuple[float, float | None]]],
    inches: float, **told: Any,
) -> Figure:  # fmt: skip
    """A group of bars for each label, a bar a rule: its height, and the paper's, a line across, where it has one.

    inches: width of a group; told: settings of the axes.
    """
    figure = new_figure(2.0 + inches * len(bars), 4.5)
    axes = figure.add_subplot()
    for k, rule in enumerate(rules):
        places = np.arange(len(bars)) + 0.27 * (k - 1)
        axes.bar(places, [of[rule][0] for of in bars], 0.25, label=rule)
        for place, of in zip(places, bars, strict=True):
            published = of[rule][1]
            if published is not None:
                axes.plot([place - 0.12, place + 0.12], [published, published], color="black", linewidth=2.0)
    axes.set_xticks(range(len(bars)), labels)
    axes.set(**told)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure
