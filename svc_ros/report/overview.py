"""One picture of a run: the scans that were aligned, from above, and the links that were not.

Every part of a run that accepted links hold together (see `links.join_scans`) has a panel of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core import se3
from svc_ros.core.errors import InputError, MissingDependencyError
from svc_ros.core.result import Verdict
from svc_ros.core.scan import Array, IndexArray, frozen_array
from svc_ros.report.links import Link, Part, join_scans

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINK_COLOURS = {
    Verdict.ACCEPTED: "#1f9d4d",
    Verdict.REJECTED: "#d62728",
    Verdict.UNDECIDED: "#f08c00",
    Verdict.DROPPED: "#8a8f98",
}
_MAX_POINTS = 400_000
_CELL_M = 0.25  # of the columns that tell walls from ground
_INK, _FRAME, _PAPER = "#22272e", "#d0d5dc", "white"
_DPI = 150
_SCAN_COLOURS = np.array([[0.09, 0.16, 0.36], [0.12, 0.47, 0.76], [0.53, 0.33, 0.80]])
_WIDTH_IN, _TEXT_IN = 13.0, 1.4  # the texts stand above and below the sheet


@dataclass(frozen=True, eq=False)
class _Panel:
    """A part ready to draw: points (N, 2) [m], their scan (N,) and how upright the surface is (N,), in [0, 1];
    stations (S, 2) of the scans; low, high: (2,) corners of what is shown. All in the part's frame."""

    part: Part
    points: Array
    point_scan: IndexArray
    upright: Array
    stations: Array
    low: Array
    high: Array


def draw_overview(
    path: str | Path, clouds: Sequence[ArrayLike], links: Sequence[Link], title: str = "Registered scans"
) -> None:
    """Write a PNG: the clouds from above, walls dark and ground pale, and every link in the colour of its verdict.

    clouds: (K, 3) [m] each, in its sensor's own frame (sensor at the origin, z up); links: index into `clouds`.
    Raises InputError for no clouds or a link to a scan that is not there, MissingDependencyError without matplotlib.
    """
    if not len(clouds):
        raise InputError("overview: expected at least one scan, found none")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("drawing needs matplotlib: pip install matplotlib") from None
    arrays = [frozen_array(cloud, np.float64, f"clouds[{k}]", (None, 3)) for k, cloud in enumerate(clouds)]
    every = max(1, -(-sum(map(len, arrays)) // _MAX_POINTS))
    panels = [_panel(part, [arrays[k][::every] for k in part.scan_idx]) for part in join_scans(len(arrays), links)]
    offsets, size = _arrange(panels)
    height = float(np.clip(_WIDTH_IN * size[1] / size[0], 4.0, 18.0)) + _TEXT_IN
    figure = Figure(figsize=(_WIDTH_IN, height), facecolor=_PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.02, 0.4 * _TEXT_IN / height, 0.96, 1.0 - _TEXT_IN / height))
    axes.set(xlim=(0.0, size[0]), ylim=(-1.04 * size[1], 0.0), aspect="equal")
    axes.set_axis_off()
    for panel, offset in zip(panels, offsets, strict=True):
        _draw_panel(axes, panel, offset, len(arrays))
    stations = _stations(panels, offsets)
    _draw_links(axes, stations, links)
    _draw_stations(axes, panels, stations)
    _draw_scale(axes, size)
    _draw_texts(figure, links, len(arrays), title)
    try:
        figure.savefig(path, dpi=_DPI, facecolor=_PAPER, format="png")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _panel(part: Part, clouds: list[Array]) -> _Panel:
    points = np.concatenate([se3.apply(T, cloud) for T, cloud in zip(part.T_part_scan, clouds, strict=True)])
    scan = np.concatenate([np.full(len(cloud), k) for k, cloud in zip(part.scan_idx, clouds, strict=True)])
    stations = part.T_part_scan[:, :2, 3]
    low, high = stations.min(0), stations.max(0)
    if len(points):
        low = np.minimum(low, np.percentile(points[:, :2], 0.7, axis=0))
        high = np.maximum(high, np.percentile(points[:, :2], 99.3, axis=0))
    margin = 2.0 + 0.02 * (high - low).max()
    low, high = low - margin, high + margin
    shown = ((points[:, :2] > low) & (points[:, :2] < high)).all(1)
    points = points[shown]
    return _Panel(part, points[:, :2], scan[shown], _uprightness(points), stations, low, high)


def _uprightness(points: Array) -> Array:
    """(N,) in [0, 1]: how many levels the column of a point fills; ground and ceiling fill one each, walls many."""
    cells = np.floor((points - points.min(0, initial=0.0)) / _CELL_M).astype(np.int64)
    column = cells[:, 0] << 24 | cells[:, 1]
    filled = np.unique(column << 12 | np.minimum(cells[:, 2], 4095))
    columns, levels = np.unique(filled >> 12, return_counts=True)
    return np.asarray(np.clip((levels[np.searchsorted(columns, column)] - 2) / 5.0, 0.0, 1.0))


def _arrange(panels: list[_Panel]) -> tuple[Array, Array]:
    """Offsets (P, 2) of the parts' frames on the sheet (x right, y up, from its upper left) and the sheet's size (2,).

    Row by row, in as many columns as bring the sheet nearest to a landscape page.
    """
    sizes = np.array([panel.high - panel.low for panel in panels])
    gap = 0.04 * sizes.max()

    def sheet(columns: int) -> tuple[Array, Array]:
        corners, top, width = [], 0.0, 0.0
        for start in range(0, len(sizes), columns):
            row = sizes[start : start + columns]
            left = np.concatenate([[0.0], np.cumsum(row[:, 0] + gap)])
            corners += [(x, top - row[k, 1]) for k, x in enumerate(left[:-1])]
            top, width = top - row[:, 1].max() - gap, max(width, left[-1] - gap)
        return np.array(corners), np.array([width, -top - gap])

    layouts = [sheet(columns) for columns in range(1, len(sizes) + 1)]
    corners, size = min(layouts, key=lambda layout: abs(np.log(layout[1][0] / layout[1][1] / 1.4)))
    return corners - np.array([panel.low for panel in panels]), size


def _stations(panels: list[_Panel], offsets: Array) -> dict[int, Array]:
    return {
        int(k): place + offset
        for panel, offset in zip(panels, offsets, strict=True)
        for k, place in zip(panel.part.scan_idx, panel.stations, strict=True)
    }


def _scan_colours(scan: IndexArray, num_scans: int) -> Array:
    """RGB (N, 3) of scans, first to last, in hues that no verdict has."""
    share = scan / max(num_scans - 1, 1)
    return np.stack([np.interp(share, np.linspace(0, 1, len(_SCAN_COLOURS)), c) for c in _SCAN_COLOURS.T], -1)


def _draw_panel(axes: Axes, panel: _Panel, offset: Array, num_scans: int) -> None:
    from matplotlib.patches import Rectangle

    corner, (width, height) = panel.low + offset, panel.high - panel.low
    axes.add_patch(Rectangle((corner[0], corner[1]), width, height, fill=False, edgecolor=_FRAME, linewidth=0.8))
    order = np.argsort(panel.upright, kind="stable")  # walls on top
    strength = (0.22 + 0.75 * panel.upright[order])[:, None]
    colours = 1.0 - strength * (1.0 - _scan_colours(panel.point_scan[order], num_scans))
    x, y = (panel.points[order] + offset).T
    axes.scatter(x, y, s=0.35, c=colours, marker="o", linewidths=0, zorder=1)
    first, last = panel.part.scan_idx[[0, -1]]
    name = f"scan {first}" if first == last else f"scans {first} to {last}, in the frame of scan {first}"
    axes.annotate(name, (corner[0], corner[1] + height), (5, -12), textcoords="offset points", fontsize=8, color=_INK,
                  bbox={"boxstyle": "round,pad=0.15", "fc": _PAPER, "ec": "none", "alpha": 0.8}, zorder=5)  # fmt: skip


def _draw_links(axes: Axes, stations: dict[int, Array], links: Sequence[Link]) -> None:
    for link in links:
        ends = np.stack([stations[link.target], stations[link.source]])
        colour, accepted = LINK_COLOURS[link.verdict], link.verdict is Verdict.ACCEPTED
        axes.plot(*ends.T, color=_PAPER, linewidth=4.0, zorder=2, solid_capstyle="round")
        axes.plot(*ends.T, color=colour, linewidth=2.2, linestyle="-" if accepted else (0, (3, 1.5)), zorder=3)
        if not accepted:
            axes.plot(*ends.mean(0), marker="X", color=colour, markersize=9, markeredgecolor=_PAPER, zorder=5)


def _draw_stations(axes: Axes, panels: list[_Panel], stations: dict[int, Array]) -> None:
    places = np.stack([stations[k] for k in sorted(stations)])
    axes.scatter(places[:, 0], places[:, 1], s=16, c=_PAPER, edgecolors=_INK, linewidths=0.9, zorder=4)
    first = np.stack([stations[int(panel.part.scan_idx[0])] for panel in panels])
    axes.scatter(first[:, 0], first[:, 1], s=42, c=_INK, edgecolors=_PAPER, linewidths=1.0, zorder=4)


def _draw_scale(axes: Axes, size: Array) -> None:
    wanted = 0.12 * size[0]
    length = max((m * 10.0**e for m in (1, 2, 5) for e in range(-1, 5) if m * 10.0**e <= wanted), default=wanted)
    y = -1.032 * size[1]
    axes.plot([0.99 * size[0] - length, 0.99 * size[0]], [y, y], color=_INK, linewidth=2.0, zorder=6)
    axes.annotate(f"{length:g} m", (0.99 * size[0] - 0.5 * length, y), (0, 4), textcoords="offset points", ha="center",
                  fontsize=9, color=_INK, zorder=6)  # fmt: skip


def _draw_texts(figure: Figure, links: Sequence[Link], num_scans: int, title: str) -> None:
    from matplotlib.legend_handler import HandlerTuple
    from matplotlib.lines import Line2D

    counts = Counter(link.verdict for link in links)
    numbers = ", ".join(f"{counts[verdict]} {verdict.value}" for verdict in LINK_COLOURS if counts[verdict])
    inch = 1.0 / figure.get_figheight()
    figure.text(0.02, 1.0 - 0.30 * inch, title, fontsize=15, fontweight="bold", color=_INK, va="center")
    subtitle = f"{num_scans} scans, {len(links)} pairs" + (f": {numbers}" if numbers else "")
    figure.text(0.02, 1.0 - 0.62 * inch, subtitle, fontsize=11, color=_INK, va="center")
    handles: list[Any] = [
        Line2D([], [], color=colour, linewidth=2.2, linestyle="-" if verdict is Verdict.ACCEPTED else (0, (3, 1.5)))
        for verdict, colour in LINK_COLOURS.items() if counts[verdict]
    ]  # fmt: skip
    labels = [f"{verdict.value} pair" for verdict in LINK_COLOURS if counts[verdict]]
    dot: dict[str, Any] = {"marker": "o", "linestyle": "none"}
    handles += [Line2D([], [], **dot, markersize=8, color=_INK)]
    handles += [Line2D([], [], **dot, markersize=5, markerfacecolor=_PAPER, color=_INK)]
    handles += [tuple(Line2D([], [], **dot, markersize=5, color=tuple(colour)) for colour in _SCAN_COLOURS)]
    labels += ["reference scan of a part", "scan", "points, first to last scan"]
    figure.legend(handles, labels, loc="lower center", ncols=len(handles), frameon=False, fontsize=9, labelcolor=_INK,
                  handler_map={tuple: HandlerTuple(ndivide=None)})  # fmt: skip
