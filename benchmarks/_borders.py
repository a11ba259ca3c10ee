"""Fits the borders of the decision: one value for all sensors, the geometric middle between right and wrong poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from _evidence import Row
from _rules import Configs, is_moved

_FLOOR = 1e-3  # as in core/decision.py
_ROOM = 1.5  # beyond the worst right pose, for a border that no wrong pose needs


@dataclass(frozen=True)
class Border:
    """A border of DecisionConfig. badness(row): grows with what speaks against a pose; to_value: badness to border."""

    name: str
    badness: Callable[[Row], float]
    to_value: Callable[[float], float]


def _per_overlap(kind: str) -> Callable[[Row], float]:
    def badness(row: Row) -> float:
        n = row.seen["refined"]
        worst = max(n[f"{kind}_ratio_source_in_target"], n[f"{kind}_ratio_target_in_source"])
        return (worst + _FLOOR) / max(n["oriented_overlap_ratio"], _FLOOR)

    return badness


BORDERS = (
    Border("max_blocked_per_overlap", _per_overlap("blocked"), lambda bad: bad),
    Border("max_scattered_per_overlap", _per_overlap("scattered"), lambda bad: bad),
    Border(
        "min_oriented_overlap",
        lambda row: 1.0 / max(row.seen["refined"]["oriented_overlap_ratio"], _FLOOR),
        lambda bad: 1.0 / bad,
    ),
)


@dataclass(frozen=True)
class Gap:
    """What one border separates in some rows: the worst right pose and the best of the wrong ones it has to stop.

    Values are those of the border itself; None where no wrong pose is this border's. num_wrong: how many are.
    """

    right: float
    wrong: float | None
    num_wrong: int


def judged(rows: Sequence[Row], configs: Configs) -> list[Row]:
    """Rows that the borders have to tell apart: not moved away, and not stopped by surfaces seen from both sides."""
    return [
        row for row in rows
        if not is_moved(row, configs[row.dataset])
        and (row.correct or _opposed(row) < configs[row.dataset].decision.max_opposed_per_overlap)
    ]  # fmt: skip


def _opposed(row: Row) -> float:
    n = row.seen["refined"]
    return (n["opposed_ratio"] + _FLOOR) / max(n["oriented_overlap_ratio"], _FLOOR)


def measure_gaps(rows: Sequence[Row], worst_right: Mapping[str, float]) -> dict[str, Gap]:
    """The gap of every border in these rows.

    A wrong pose has to be stopped by one border only: the one that it is farthest beyond, seen from the worst right
    pose of all rows that are fitted (`worst_right`, badness by border).
    """
    gaps = {}
    stopped_by = {border.name: [] for border in BORDERS}  # type: dict[str, list[float]]
    for row in rows:
        if not row.correct:
            beyond = {b.name: b.badness(row) / worst_right[b.name] for b in BORDERS}
            name = max(beyond, key=beyond.__getitem__)
            stopped_by[name].append(beyond[name] * worst_right[name])
    for border in BORDERS:
        right = max((border.badness(row) for row in rows if row.correct), default=math.nan)
        wrong = min(stopped_by[border.name], default=None)
        gaps[border.name] = Gap(
            border.to_value(right), None if wrong is None else border.to_value(wrong), len(stopped_by[border.name])
        )
    return gaps


def find_worst_right(rows: Sequence[Row]) -> dict[str, float]:
    """The largest badness of every border among right poses."""
    return {border.name: max(border.badness(row) for row in rows if row.correct) for border in BORDERS}


def fit_borders(rows: Sequence[Row]) -> dict[str, float]:
    """Each border in the geometric middle of its gap; a little beyond the right poses where it has none to stop."""
    worst_right = find_worst_right(rows)
    gaps = measure_gaps(rows, worst_right)
    fitted = {}
    for border in BORDERS:
        gap = gaps[border.name]
        room = border.to_value(_ROOM * worst_right[border.name])
        fitted[border.name] = room if gap.wrong is None else math.sqrt(gap.right * gap.wrong)
    return fitted
