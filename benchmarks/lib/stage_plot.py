"""The picture of stages.py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lib.figures import new_figure, write_figure


def draw(tables: Mapping[str, Mapping[str, Any]], checks: Mapping[str, Any], path: Path) -> None:
    """A panel for every table of stages, and one for the sight-view check beside its twins; axes are logarithmic."""
    figure = new_figure(12.0, 9.0)
    panels = figure.subplots(2, 2).ravel()
    for axes, (name, table) in zip(panels, tables.items(), strict=False):
        for stage, values in table.items():
            label = f"{stage} (exponent {values['exponent']:.2f})"
            axes.loglog(values["number"], values["time_ms"], "o-", label=label)
        axes.set(xlabel=name, title=f"stages against {name}")
    _draw_checks(panels[-1], checks)
    for axes in panels:
        axes.set(ylabel="median time [ms]")
        axes.grid(which="both", alpha=0.25)
        axes.legend(fontsize=7)
    write_figure(figure, path)


def _draw_checks(axes: Any, checks: Mapping[str, Any]) -> None:
    for k, (name, curve) in enumerate(checks.items()):
        for method, style in (("svc_ros", "o-"), ("cKDTree", "s:")):
            times = curve["time_ms"][method]
            axes.loglog(curve["number"], times, style, color=f"C{k}", label=f"{name}: {method}")
    axes.set(xlabel="points of each scan", title="one sight-view check, one direction, target prepared")
