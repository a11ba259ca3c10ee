"""From what single pairs gave to the report of a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from svc_ros.evaluation.metrics import (
    LabelledDecision,
    PairOutcome,
    decision_metrics,
    false_accepts_by_origin,
    percentile,
    registration_metrics,
)

Row = dict[str, Any]

_COUNTS = ("num_pairs", "num_accepted", "num_correct_accepted", "num_false_accepted")


@dataclass
class JobReport:
    """What one unit of work found: rows for the report, outcomes and decisions for the metrics, times [ms].

    register_times: the stages of each registration; scan_times: of each scan that was prepared for it; verify_ms: the
    totals of the verifications.
    """

    row: Row | None = None
    outcome: PairOutcome | None = None
    decisions: list[LabelledDecision] = field(default_factory=list)
    register_times: list[Mapping[str, float]] = field(default_factory=list)
    verify_ms: list[float] = field(default_factory=list)
    scan_times: list[Mapping[str, float]] = field(default_factory=list)


def summarise_pairs(reports: Sequence[JobReport]) -> Row:
    """Numbers and rows of the pairs with a reference."""
    return {**registration_metrics(_outcomes(reports)), "pairs": [r.row for r in reports]}


def summarise_candidates(reports: Sequence[JobReport]) -> Row | None:
    """Numbers of the judged poses; None where the data set has none."""
    decisions = [d for report in reports for d in report.decisions]
    if not reports:
        return None
    return {**decision_metrics(decisions), "false_accepted_by_origin": false_accepts_by_origin(decisions)}


def summarise_negatives(reports: Sequence[JobReport]) -> Row | None:
    """Numbers and rows of the pairs that have no alignment; None where the data set has none."""
    if not reports:
        return None
    num_accepted = sum(o.accepted for o in _outcomes(reports))
    return {"num_pairs": len(reports), "num_false_accepted": num_accepted, "pairs": [r.row for r in reports]}


def summarise_times(reports: Sequence[JobReport]) -> Row:
    """Percentiles [ms]. Features are given to every registration, so its own stages of that name are empty."""
    registered = [times for r in reports for times in r.register_times]
    totals = [times["total"] for times in registered if "total" in times]
    scans = [times for r in reports for times in r.scan_times]
    stages = {**_stage_medians(registered), **_stage_medians(scans)}
    stages.pop("total", None)
    return {
        "register_p50": percentile(totals, 50),
        "register_p95": percentile(totals, 95),
        "verify_p50": percentile((ms for r in reports for ms in r.verify_ms), 50),
        "features_p50": stages.get("features"),
        "stages_p50": stages,
    }


def summarise_total(reports: Sequence[Row]) -> Row:
    """Numbers over several data sets' reports: pairs are counted together, each with its own set's thresholds."""
    found = [report["registration"] for report in reports]
    counts = {key: sum(section[key] for section in found) for key in _COUNTS}
    right = sum(round((s["candidate_success_rate"] or 0.0) * s["num_pairs"]) for s in found)
    num_pairs = counts["num_pairs"]
    negatives = [report["negatives"] for report in reports if report["negatives"]]
    return {
        **counts,
        "success_rate": counts["num_correct_accepted"] / num_pairs if num_pairs else None,
        "candidate_success_rate": right / num_pairs if num_pairs else None,
        "num_negatives": sum(section["num_pairs"] for section in negatives),
        "num_false_accepted_negatives": sum(section["num_false_accepted"] for section in negatives),
    }


def _outcomes(reports: Sequence[JobReport]) -> list[PairOutcome]:
    return [r.outcome for r in reports if r.outcome is not None]


def _stage_medians(times: Sequence[Mapping[str, float]]) -> dict[str, float | None]:
    names = dict.fromkeys(name for entry in times for name in entry)
    return {name: percentile((entry[name] for entry in times if name in entry), 50) for name in names}
