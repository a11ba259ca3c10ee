"""Makes the pictures of README.md from what `make demo` left: `.venv/bin/python tools/readme_pictures.py`."""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.registration import prepare, verify
from svc_ros.core.scan import PreparedScan
from svc_ros.core.sight.evidence import SightViewEvidence
from svc_ros.core.sight.sight_view import gather_evidence
from svc_ros.io.bags import Bag
from svc_ros.io.trajectories import read_tum

PROJECT_ROOT = Path(__file__).resolve().parent.parent
PRESET = "lidar_outdoor"
SHOWN_M = 32.0  # to each side of the sensor
DRAWN_EVERY = 8  # of the blocked lines; all denied points are drawn
_TARGET, _SOURCE, _DENIED = "#9aa3ae", "#1f77b4", "#d62728"


def shrink(picture: Path, out: Path, width: int = 1300, colours: int = 96) -> None:
    """Write a smaller copy of a PNG, with few colours, rare ones among them."""
    with Image.open(picture) as image:
        size = (width, round(width * image.height / image.width))
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(out, optimize=True)


def draw_sight_lines(drive: Path, out: Path) -> None:
    """Two poses of the same pair of scans: the true one, and one turned by half a circle."""
    config = preset(PRESET)
    with Bag(drive / "bag") as bag:
        target, source = (prepare(reading.scan, config) for reading in islice(bag.scans(), 2))
    poses = read_tum(drive / "reference_tum.txt").poses
    right = se3.invert(poses[0]) @ poses[1]
    turned = right @ np.diag([-1.0, -1.0, 1.0, 1.0])
    figure = Figure(figsize=(13.0, 6.9), facecolor="white")
    FigureCanvasAgg(figure)
    names = ("true pose", "turned by 180 degrees")
    for axes, name, T in zip(figure.subplots(1, 2), names, (right, turned), strict=True):
        result = verify(source, target, T, config)
        evidence = gather_evidence(source, target, T, config.sight_view)
        _draw_pose(axes, source, target, T, evidence)
        lines = evidence.source_in_target
        axes.set_title(f"{name}: {result.verdict.value}", loc="left", fontsize=15, fontweight="bold")
        axes.set_xlabel(
            f"denied surface {evidence.denied_ratio:.1%}, {lines.num_blocked / lines.num_lines:.1%} of the sight lines "
            f"blocked, oriented overlap {evidence.oriented_overlap_ratio:.2f}", loc="left", fontsize=12,
        )  # fmt: skip
    figure.tight_layout()
    figure.savefig(out.with_suffix(".large.png"), dpi=110)
    shrink(out.with_suffix(".large.png"), out)
    out.with_suffix(".large.png").unlink()


def _draw_pose(
    axes: Any, source: PreparedScan, target: PreparedScan, T: np.ndarray, evidence: SightViewEvidence
) -> None:
    placed, lines = se3.apply(T, source.points), evidence.source_in_target
    axes.scatter(*target.points[:, :2].T, s=1.2, c=_TARGET, linewidths=0)
    axes.scatter(*placed[:, :2].T, s=1.2, c=_SOURCE, linewidths=0)
    for seen in target.points[lines.blocked_idx[::DRAWN_EVERY]]:
        axes.plot(*np.stack([target.sensor_origin, seen])[:, :2].T, color=_DENIED, linewidth=0.5, alpha=0.35)
    for points, surface in ((placed, evidence.source_surface), (target.points, evidence.target_surface)):
        axes.scatter(*points[surface.denied_idx, :2].T, s=6, c=_DENIED, linewidths=0, zorder=4)
    axes.plot(*target.sensor_origin[:2], marker="o", markersize=8, color="black", zorder=5)
    axes.set(xlim=(-SHOWN_M, SHOWN_M), ylim=(-SHOWN_M, SHOWN_M), aspect="equal", xticks=[], yticks=[])


def main() -> None:
    """Write docs/images/overview.png and docs/images/sight_lines.png."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--demo", type=Path, default=PROJECT_ROOT / "out/demo", help="what make demo left")
    parser.add_argument("--out", type=Path, default=PROJECT_ROOT / "docs/images")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    shrink(options.demo / "overview.png", options.out / "overview.png")
    draw_sight_lines(options.demo / "drive", options.out / "sight_lines.png")


if __name__ == "__main__":
    main()
