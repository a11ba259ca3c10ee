"""What the rows of registration.json add up to: right, accepted and wrong answers, by overlap, by sensor and by set.

A row is what one method made of one pair. A negative is a pair of scans from different places, where no pose is right.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from svc_ros.evaluation.metrics import percentile

BINS = (
    ("< 0.1", 0.0, 0.1), ("0.1-0.2", 0.1, 0.2), ("0.2-0.3", 0.2, 0.3), ("0.3-0.5", 0.3, 0.5), ("0.5-0.7", 0.5, 0.7),
    ("> 0.7", 0.7, float("inf")),
)  # fmt: skip
NEGATIVES = "different places"
ALL = "all sets"
Row = Mapping[str, Any]


def read_rows(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All rows of a report; what a file of an earlier version does not tell is None, and a set's sensor is the set."""
    unknown = {"score": None, "total_ms": None}
    return [{**unknown, "sensor": r["dataset"], "negative": r["overlap"] is None, **r} for r in report["pairs"]]


def methods_of(rows: Iterable[Row]) -> list[str]:
    """Every method once, in the order in which they were asked."""
    return list(dict.fromkeys(row["method"] for row in rows))


def of_method(rows: Iterable[Row], method: str) -> list[Row]:
    """One method's rows."""
    return [row for row in rows if row["method"] == method]


def grouped(rows: Iterable[Row], key: str) -> dict[str, list[Row]]:
    """Rows by `dataset` or `sensor`, in the order in which they come."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups


def count(rows: Iterable[Row]) -> dict[str, int]:
    """Pairs, right candidates (accepted or not), those of them that are accepted, and wrong ones that are."""
    told = [(bool(row["accepted"]), bool(row["correct"])) for row in rows]
    return {
        "num_pairs": len(told),
        "num_right": sum(right for _, right in told),
        "num_accepted_right": sum(accepted and right for accepted, right in told),
        "num_false_accepted": sum(accepted and not right for accepted, right in told),
    }


def by_overlap(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """The counts of one method in each bin of overlap, negatives in a bin of their own."""
    known = [row for row in rows if row["overlap"] is not None]
    bins = {name: count(r for r in known if low <= r["overlap"] < high) for name, low, high in BINS}
    return {**bins, NEGATIVES: count(row for row in rows if row["negative"])}


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """One method on some pairs. Counts are of pairs with a reference, those of negatives stand beside them.

    num_right_above_wrong: see `right_above_wrong`; time_ms: from raw points to the answer.
    """
    negatives = count(row for row in rows if row["negative"])
    times = [row["total_ms"] for row in rows if row["total_ms"] is not None]
    return {
        **count(row for row in rows if not row["negative"]),
        "num_negatives": negatives["num_pairs"],
        "num_negatives_accepted": negatives["num_false_accepted"],
        "num_right_above_wrong": right_above_wrong(rows),
        "by_overlap": by_overlap(rows),
        "time_ms_p50": percentile(times, 50),
        "time_ms_p95": percentile(times, 95),
    }


def right_above_wrong(rows: Sequence[Row]) -> int | None:
    """How many right answers score above every wrong one, negatives too: what the best threshold would accept without
    a false accept, chosen with hindsight on these very pairs. None where no answer has a score.
    """
    scores = [(row["score"], row["correct"]) for row in rows if row["score"] is not None]
    if not scores:
        return None
    worst = max((score for score, right in scores if not right), default=-float("inf"))
    return sum(right and score > worst for score, right in scores)


def tabulate(rows: Sequence[Row], key: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Summaries by group and method, and of all together."""
    groups = {**grouped(rows, key), ALL: list(rows)}
    return {name: {m: summarise(of_method(inside, m)) for m in methods_of(inside)} for name, inside in groups.items()}
