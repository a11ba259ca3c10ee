"""The numbers behind the plots of a report: the decision's border, times by stage, the way from above."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.decision import decide
from svc_ros.core.decision_config import DecisionConfig
from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.result import Verdict
from svc_ros.core.scan import Array
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.io.trajectories import Trajectory
from svc_ros.report.data import Record, Run, verdict_of
from svc_ros.report.links import Link, join_scans
from svc_ros.report.sight_lines import choose_evenly

MAX_PATH_POINTS = 3000
_POINTS = 10_000  # of each made-up scan that finds the border: its resolution is one in the agreeing ones
_MOST_DENIED = 20 * _POINTS
_SMALL = 0.1  # of the angle at which clusters count fully: a person, not a wall


def decision_border(config: Config) -> dict[str, Any] | None:
    """Where denied share and overlap alone decide; None for methods that decide otherwise.

    min_overlap: less is never accepted; outer (K,) at overlap (K,): where more than this is denied nothing is accepted,
    though surfaces face all ways and small clusters are denied; inner (K,): less is never rejected for it, though
    surfaces leave a direction open and one wide cluster is denied. In between, structure and clusters decide. Both
    borders are found by asking the decision itself.
    """
    if config.method != "svc":
        return None
    limits = config.decision
    overlap = np.linspace(1.0001 * limits.min_oriented_overlap, 1.0, 31)
    return {
        "min_overlap": limits.min_oriented_overlap,
        "overlap": overlap.round(4).tolist(),
        "outer": [_last_denied(_accepted_at_best, x, limits) for x in overlap.tolist()],
        "inner": [_last_denied(_not_rejected_at_worst, x, limits) for x in overlap.tolist()],
    }


def _last_denied(holds: Callable[[float, int, DecisionConfig], bool], overlap: float, limits: DecisionConfig) -> float:
    """The largest denied share up to which `holds` is true."""
    low, high = 0, _MOST_DENIED
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds(overlap, middle, limits) else (low, middle)
    return round(_agreeing(overlap, low, 0.0, 0.0).denied_ratio, 5)


def _accepted_at_best(overlap: float, num_denied: int, limits: DecisionConfig) -> bool:
    """What is denied is seen as small clusters, and the surfaces that agree face all ways alike."""
    evidence = _agreeing(overlap, num_denied, _SMALL, 1.0 / 3.0)
    return decide(evidence, limits).verdict is Verdict.ACCEPTED


def _not_rejected_at_worst(overlap: float, num_denied: int, limits: DecisionConfig) -> bool:
    """What is denied is one wide cluster, and the surfaces that agree leave a direction open."""
    evidence = _agreeing(overlap, num_denied, 1.0, 0.0)
    return decide(evidence, limits).verdict is not Verdict.REJECTED


def _agreeing(overlap: float, num_denied: int, wide_share: float, structure: float) -> SightViewEvidence:
    """Two scans of which that share agrees, so many points of each denied, and nothing else against the pose."""
    denied = np.zeros(num_denied, np.int64)
    seen = SeenSurface(_POINTS, round(overlap * _POINTS), denied, wide_share * num_denied, 0, 0)
    clear = SightLines(_POINTS, 0, denied[:0], denied[:0])
    return SightViewEvidence(
        clear, clear, overlap, overlap, 0.0, weakest_constraint=structure, source_surface=seen, target_surface=seen
    )


def stage_times(records: Sequence[Record]) -> dict[str, Any]:
    """Median and 95th percentile [ms] of every stage over the decisions that had it, and of their totals.

    Decisions that took no time are left out. The stage on which most time was spent in all comes first; num: how many
    decisions had each stage.
    """
    times = [record["time_ms"] for record in records if (record.get("time_ms") or {}).get("total")]
    spent = {name: [float(entry[name]) for entry in times if name in entry] for entry in times for name in entry}
    totals = spent.pop("total", [])
    stages = sorted(spent, key=lambda name: (-sum(spent[name]), name))
    return {
        "num_decisions": len(times),
        "stages": stages,
        "num": [len(spent[name]) for name in stages],
        "median_ms": [_percentile(spent[name], 50) for name in stages],
        "p95_ms": [_percentile(spent[name], 95) for name in stages],
        "total_median_ms": _percentile(totals, 50),
        "total_p95_ms": _percentile(totals, 95),
    }


def _percentile(values: Sequence[float], q: float) -> float:
    return round(float(np.percentile(values, q)), 3) if values else 0.0


def map_from_above(run: Run, reference: Trajectory | None, drawn: Sequence[int]) -> dict[str, Any]:
    """The way, the same after the loops, the reference (moved rigidly onto the way), and a link for every drawn
    decision on two placed scans.

    Coordinates [m] are x and y of the trajectory, or of the reference where there is none, or of scans placed by
    accepted pairs where there is neither.
    """
    way, basis = _way(run, reference)
    links: dict[str, list[Any]] = {verdict.value: [] for verdict in Verdict}
    unplaced = 0
    for k in drawn:
        record = run.records[k]
        stamps = [int(record.get(f"{side}_stamp_ns") or 0) for side in ("target", "source")]
        if not all(stamps) or stamps[0] == stamps[1]:
            continue
        ends = None if way is None else [_place(way, stamp) for stamp in stamps]
        if ends is None or ends[0] is None or ends[1] is None:
            unplaced += 1
            continue
        links[verdict_of(record).value].append([k, *ends[0], *ends[1]])
    drawn_reference = None if reference is None or basis == "reference" else _moved_onto(reference, way)
    return {
        "basis": basis,
        "way": _xy(way),
        "optimized": _xy(run.optimized),
        "reference": _xy(drawn_reference),
        "links": links,
        "num_unplaced": unplaced,
    }


def _way(run: Run, reference: Trajectory | None) -> tuple[Trajectory | None, str]:
    if run.trajectory is not None:
        return run.trajectory, "trajectory"
    if reference is not None:
        return reference, "reference"
    return _chain(run.records), "accepted pairs"


def _chain(records: Sequence[Record]) -> Trajectory | None:
    """The largest set of scans that accepted pairs hold together, in the frame of its first scan."""
    pairs = [(int(r.get("source_stamp_ns") or 0), int(r.get("target_stamp_ns") or 0), r) for r in records]
    stamps = sorted({stamp for source, target, _ in pairs for stamp in (source, target)})
    number = {stamp: k for k, stamp in enumerate(stamps)}
    links = [
        Link(number[source], number[target], Verdict.ACCEPTED, np.array(record["T_target_source"], float))
        for source, target, record in pairs
        if verdict_of(record) is Verdict.ACCEPTED and record.get("T_target_source") and source != target
    ]
    if not links:
        return None
    part = max(join_scans(len(stamps), links), key=lambda part: len(part.scan_idx))
    return Trajectory(np.array(stamps, np.int64)[part.scan_idx], part.T_part_scan)


def _place(way: Trajectory, stamp_ns: int) -> list[float] | None:
    try:
        pose = way.at(stamp_ns)
    except TransformUnavailableError:
        return None
    return [round(float(value), 2) for value in pose[:2, 3]]


def _moved_onto(reference: Trajectory, way: Trajectory | None) -> Trajectory | None:
    """The reference during the way, after the rigid motion that brings it nearest to the way at the way's stamps."""
    if way is None:
        return None
    during = (reference.stamps_ns >= way.stamps_ns[0]) & (reference.stamps_ns <= way.stamps_ns[-1])
    inside = (way.stamps_ns >= reference.stamps_ns[0]) & (way.stamps_ns <= reference.stamps_ns[-1])
    stamps = choose_evenly(way.stamps_ns[inside], MAX_PATH_POINTS)
    if len(stamps) < 3:
        return None
    from_places = np.stack([reference.at(int(stamp))[:3, 3] for stamp in stamps])
    to_places = np.stack([way.at(int(stamp))[:3, 3] for stamp in stamps])
    T, determined = se3.kabsch(from_places[None], to_places[None], np.ones((1, len(stamps))))
    if not determined[0]:  # a straight way: its first pose says how it is turned
        T = (way.at(int(stamps[0])) @ se3.invert(reference.at(int(stamps[0]))))[None]
    return Trajectory(reference.stamps_ns[during], T[0] @ reference.poses[during])


def _xy(way: Trajectory | None) -> list[list[float]]:
    if way is None:
        return []
    rows: Array = way.poses[choose_evenly(np.arange(len(way)), MAX_PATH_POINTS), :2, 3]
    return [[round(float(value), 2) for value in row] for row in rows]
