"""Draws what `svc` looks at and where it accepts: `.venv/bin/python tools/decision_pictures.py`.

From simulated scans and the configured decision; nothing is downloaded or left behind.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import Config, DecisionConfig, preset
from svc_ros.core.decision import Decision, decide
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import Verdict
from svc_ros.core.scan import PreparedScan
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.placement import Placement, place
from svc_ros.core.sight.seen_surface import look_through
from svc_ros.simulation import DriveConfig, drive_scans

PROJECT_ROOT = Path(__file__).resolve().parent.parent
PRESET = "lidar_outdoor"
DRIVE = DriveConfig(num_scans=3, seed=7, moving_share=0.3)
SHOWN_M = (38.0, 15.5)  # to each side of the sensor, along and across the street
HIGH_M = 0.35  # over the ground, which would hide the rest
CLASSES = ("unseen", "hidden", "near", "confirmed", "denied")  # drawn in this order
COLOURS = {"unseen": "#d5d9de", "hidden": "#8fa3bd", "near": "#d9c27a", "confirmed": "#1b8a3d", "denied": "#d91c1c"}
WORDS = {
    "confirmed": "confirmed: seen alike", "denied": "denied: looked through", "hidden": "hidden behind what it saw",
    "unseen": "not looked at", "near": "too near to tell",
}  # fmt: skip

_FREE = "#fdf6d8"

STRUCTURE = np.linspace(0.0, 1.0 / 3.0, 101)
DENIED = np.geomspace(1e-3, 0.9, 120)
POINTS = 10_000  # that both scans of the border's made-up pairs confirm of each other
CLUSTERS = {"small": 0.1, "wide": 1.0}  # by what share of their number denied points count
_LINES = {"small": "#b35806", "wide": "#542788"}


def simulated_pair(config: Config) -> tuple[PreparedScan, PreparedScan, NDArray[np.float64]]:
    """Source, target and the true pose of two scans of a street with traffic."""
    scans = list(drive_scans(DRIVE))
    first, last = scans[0], scans[-1]
    source, target = (prepare(scan.cast.scan(scan.stamp_ns), config) for scan in (last, first))
    return source, target, se3.invert(first.T_map_lidar) @ last.T_map_lidar


def classify(observer: PreparedScan, placement: Placement, config: Config) -> NDArray[np.str_]:
    """For each point (M,) of the placed scan its class, by asking `look_through` about that point alone."""
    other, names = placement.other, []
    for k in range(len(other)):
        alone = PreparedScan(other.points[k : k + 1], other.normals[k : k + 1], other.sensor_origin, other.voxel_size_m)
        one = dataclasses.replace(placement, other=alone, nearest=placement.nearest[k : k + 1])
        seen = look_through(observer, one, config.sight_view)
        counts = {"confirmed": seen.num_confirmed, "denied": seen.num_denied, "hidden": seen.num_hidden,
                  "unseen": seen.num_unseen}  # fmt: skip
        names.append(next((name for name, num in counts.items() if num), "near"))
    return np.array(names)


def draw_denied_surface(out: Path) -> None:
    """The same two scans at the true pose and turned by half a circle, as the target's sensor sees the source."""
    config = preset(PRESET)
    source, target, right = simulated_pair(config)
    turned = right @ np.diag([-1.0, -1.0, 1.0, 1.0])
    figure = Figure(figsize=(10.5, 10.0), facecolor="white")
    FigureCanvasAgg(figure)
    rows = figure.subplots(2, 1)
    for axes, name, T in zip(rows, ("true pose", "turned by 180 degrees"), (right, turned), strict=True):
        placement = place(target, source, T, config.sight_view)
        classes = classify(target, placement, config)
        verdict = verify(source, target, T, config).verdict.value
        _draw_classes(axes, se3.apply(T, source.points), classes, target)
        num = {kind: int((classes == kind).sum()) for kind in CLASSES}
        share = num["denied"] / max(num["denied"] + num["confirmed"], 1)
        axes.set_title(f"{name}: {verdict}", loc="left", fontsize=13, fontweight="bold")
        axes.set_xlabel(
            f"of {len(classes):,} points: {num['confirmed']:,} confirmed, {num['denied']:,} denied ({share:.1%} of "
            f"both), {num['hidden']:,} hidden, {num['unseen']:,} not looked at", loc="left", fontsize=11,
        )  # fmt: skip
    _explain(figure)
    figure.tight_layout(rect=(0.0, 0.06, 1.0, 1.0), h_pad=1.6)
    figure.savefig(out, dpi=100)


def _draw_classes(axes: Any, placed: NDArray[np.float64], classes: NDArray[np.str_], target: PreparedScan) -> None:
    """From above, hardly any ground; what the sensor looked through at its own height is tinted."""
    axes.fill(*_looked_through(target).T, color=_FREE, linewidth=0, zorder=0)
    is_high = placed[:, 2] > np.percentile(target.points[:, 2], 10.0) + HIGH_M
    for kind in CLASSES:
        some = placed[(classes == kind) & is_high]
        axes.scatter(*some[:, :2].T, s=7.0 if kind == "denied" else 4.0, c=COLOURS[kind], linewidths=0)
    axes.plot(*target.sensor_origin[:2], marker="D", markersize=7, color="black", zorder=5)
    (long_m, wide_m), (x, y) = SHOWN_M, target.sensor_origin[:2]
    axes.set(xlim=(x - long_m, x + long_m), ylim=(y - wide_m, y + wide_m), aspect="equal", xticks=[], yticks=[])


def _looked_through(target: PreparedScan, num: int = 360) -> NDArray[np.float64]:
    """Outline (num, 2) of what the sensor saw through near the horizontal: the least range of every direction."""
    relative = target.points - target.sensor_origin
    ranges = np.linalg.norm(relative, axis=1)
    level = np.abs(relative[:, 2]) < 0.03 * ranges
    sector = np.floor((np.arctan2(relative[:, 1], relative[:, 0]) / (2.0 * np.pi) % 1.0) * num).astype(int) % num
    reach = np.full(num, np.inf)
    np.minimum.at(reach, sector[level], ranges[level])
    reach = np.where(np.isfinite(reach), reach, 0.0)  # nothing came back from there: nothing is claimed
    angle = (np.arange(num) + 0.5) * 2.0 * np.pi / num
    return np.stack([np.cos(angle), np.sin(angle)], 1) * reach[:, None] + target.sensor_origin[:2]


def _explain(figure: Figure) -> None:
    dots = [
        Line2D([], [], linestyle="", marker="o", markersize=6, color=COLOURS[kind], label=words)
        for kind, words in WORDS.items()
    ]
    sensor = Line2D([], [], linestyle="", marker="D", markersize=6, color="black", label="the sensor that looked")
    free = Patch(color=_FREE, label="looked through, at its height")
    figure.legend(handles=[*dots, sensor, free], loc="lower center", ncols=4, fontsize=10, frameon=False)


def made_up(denied_share: float, structure: float, wide_share: float) -> SightViewEvidence:
    """A pose with that denied share, denied points counting by that share of theirs, and nothing else against it."""
    denied = np.zeros(round(denied_share / (1.0 - denied_share) * POINTS), np.int64)
    seen = SeenSurface(POINTS, POINTS, denied, wide_share * len(denied), 0, 0)
    lines = SightLines(POINTS, 0, denied[:0], denied[:0])
    return SightViewEvidence(
        lines, lines, 1.0, 1.0, 0.0, weakest_constraint=structure, source_surface=seen, target_surface=seen
    )


def decisions(config: DecisionConfig, wide_share: float) -> list[list[Decision]]:
    """The decision's answers, a row for each of DENIED, a column for each of STRUCTURE."""
    return [[decide(made_up(d, s, wide_share), config) for s in STRUCTURE.tolist()] for d in DENIED.tolist()]


def probabilities(config: DecisionConfig, wide_share: float) -> NDArray[np.float64]:
    """Probability (DENIED, STRUCTURE) of being right that the decision gives to each such pose."""
    return np.array([[answer.probability for answer in row] for row in decisions(config, wide_share)])


def draw_border(out: Path) -> None:
    """Denied share over structure: where the probability is one half, for small and for wide clusters."""
    config, full_deg = preset(PRESET).decision, preset(PRESET).sight_view.wide_cluster_deg
    figure = Figure(figsize=(11.0, 4.6), facecolor="white")
    FigureCanvasAgg(figure)
    tints = ListedColormap(["#dff1e3", "#fdf0cf", "#fbdcdc"])
    order = {Verdict.ACCEPTED: 0, Verdict.UNDECIDED: 1, Verdict.REJECTED: 2}
    for axes, (name, share) in zip(figure.subplots(1, 2, sharey=True), CLUSTERS.items(), strict=True):
        found = decisions(config, share)
        verdicts = np.array([[order[answer.verdict] for answer in row] for row in found])
        axes.pcolormesh(STRUCTURE, DENIED, verdicts, cmap=tints, vmin=0, vmax=2, shading="nearest", rasterized=True)
        for other, wide in CLUSTERS.items():
            chance = probabilities(config, wide)
            axes.contour(
                STRUCTURE, DENIED, chance, [0.5], colors=_LINES[other], linewidths=2.4 if other == name else 1.0,
                linestyles="solid" if other == name else "dashed",
            )  # fmt: skip
        axes.set(yscale="log", xlim=(0.0, 1.0 / 3.0), ylim=(DENIED[0], DENIED[-1]))
        axes.set_yticks([0.001, 0.003, 0.01, 0.03, 0.1, 0.3], ["0.1 %", "0.3 %", "1 %", "3 %", "10 %", "30 %"])
        axes.minorticks_off()
        undecided = DENIED[verdicts[:, 0] == 1]
        places = ((0.26, 0.004, "accepted"), (0.005, 0.7 * undecided[-1], "undecided"), (0.005, 0.55, "rejected"))
        for x, y, text in places:
            axes.text(x, y, text, fontsize=11, color="#444444", va="center")
        axes.set_xlabel("how the agreeing surfaces resist a shift\n0: a corridor, 1/3: they face all ways alike")
        title = f"denied in {name} clusters, seen over {share * full_deg:.0f} degrees"
        axes.set_title(title, loc="left", fontsize=12, color=_LINES[name])
    figure.axes[0].set_ylabel("denied share")
    figure.tight_layout()
    figure.savefig(out, dpi=100)


def main() -> None:
    """Write docs/images/denied_surface.png and docs/images/decision_border.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PROJECT_ROOT / "docs/images")
    out = parser.parse_args().out
    draw_denied_surface(out / "denied_surface.png")
    draw_border(out / "decision_border.png")


if __name__ == "__main__":
    main()
