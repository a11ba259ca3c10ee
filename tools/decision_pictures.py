"""Draws where `svc` accepts, from the configured decision: `.venv/bin/python tools/decision_pictures.py`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from svc_ros.core.config import DecisionConfig, preset
from svc_ros.core.decision import decide
from svc_ros.core.evidence import SightLines, SightViewEvidence

PROJECT_ROOT = Path(__file__).resolve().parent.parent
OVERLAP, LINES = 0.5, 10_000
SCATTERED = 0.5  # of what is blocked: half of it in the two worst sectors
CONTRADICTED = (0.1, 0.2, 0.4)  # shares of the lines that meet unmatched surface
BLOCKED = np.linspace(0.001, 0.2, 81)  # over oriented overlap
TIGHT = np.linspace(0.3, 0.97, 68)
_COLOURS = ("#1b7837", "#5aae61", "#a6dba0")


def evidence(blocked_per_overlap: float, tight: float, contradicted: float) -> SightViewEvidence:
    """A pose whose surfaces face all ways, half of both scans agreeing, both scans blocked alike."""
    num_blocked = round(blocked_per_overlap * OVERLAP * LINES)
    idx = np.zeros(num_blocked, np.int64)
    lines = SightLines(LINES, round(num_blocked / contradicted), idx, idx, round(SCATTERED * num_blocked))
    return SightViewEvidence(lines, lines, OVERLAP, OVERLAP, 0.0, tight_ratio=tight)


def probabilities(config: DecisionConfig, contradicted: float) -> Any:
    """Probability (TIGHT, BLOCKED) of being right that the decision gives to each such pose."""
    return np.array([[decide(evidence(b, t, contradicted), config).probability for b in BLOCKED] for t in TIGHT])


def draw_borders(out: Path) -> None:
    """Shares of agreeing points in tight contact over blocked shares; accepted above each line."""
    config = preset("lidar_outdoor").decision
    figure = Figure(figsize=(7.5, 4.4), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for contradicted, colour in zip(CONTRADICTED, _COLOURS, strict=True):
        axes.contour(BLOCKED, TIGHT, probabilities(config, contradicted), [0.5], colors=colour, linewidths=2)
        axes.plot([], [], color=colour, linewidth=2, label=f"{contradicted:.0%} of unmatched lines blocked")
    lines = ((config.max_blocked_where_weak, "weak surfaces:\nnone beyond"),
             (config.max_blocked_per_overlap, "below the line:\nundecided | rejected"))  # fmt: skip
    for value, name in lines:
        axes.axvline(value, color="#888888", linewidth=1, linestyle=":")
        axes.annotate(name, (value, TIGHT[0]), (3, 3), textcoords="offset points", fontsize=8, color="#555555")
    axes.set_xlabel("blocked share over oriented overlap, half of it in the two worst sectors")
    axes.set_ylabel("agreeing points in tight contact")
    axes.set_title("accepted above the line", loc="left", fontsize=11)
    axes.set(xlim=(0, BLOCKED[-1]), ylim=(TIGHT[0], TIGHT[-1]))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.14), fontsize=9)
    figure.tight_layout()
    figure.savefig(out, dpi=110)


def main() -> None:
    """Write docs/images/decision_border.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PROJECT_ROOT / "docs/images")
    draw_borders(parser.parse_args().out / "decision_border.png")


if __name__ == "__main__":
    main()
