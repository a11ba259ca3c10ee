"""The sections of the pages that registration.json makes: every method on every pair, whatever sets it was run on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lib.markdown import table, whole
from lib.tally import BINS, NEGATIVES, by_overlap, count, grouped, methods_of, of_method, read_rows, summarise

TOLD = {  # methods as registration.py names them -> as the pages do, where that differs
    "svc": "`svc`",
    "svc_paper": "`svc_paper`",
    "sc2": "`sc2`",
    "svc, first look only": "`svc` without both wider looks",
    "svc, no look on the ground": "`svc` without the look on the ground",
    "svc, one threshold, not on the ground": "`svc`, not on the ground, thresholds not pooled",
    "svc, wider FPFH too, not on the ground": "`svc`, not on the ground, a wider FPFH besides",
    "svc, three-point cliques": "`svc` with three-point cliques in place of SC2",
}
LOW = tuple(name for name, _, high in BINS if high <= 0.3)
Report = Mapping[str, Any]


def methods_table(results: Report) -> str:
    """README: every method on all pairs."""
    rows = read_rows(results["registration"])
    lines = []
    for method in methods_of(rows):
        found = summarise(of_method(rows, method))
        low = [found["by_overlap"][name] for name in LOW]
        right_at_low = sum(c["num_accepted_right"] for c in low)
        lines.append((
            _told(method), f"{found['num_accepted_right']} of {found['num_pairs']}",
            f"{right_at_low} of {sum(c['num_pairs'] for c in low)}",
            str(found["num_false_accepted"] + found["num_negatives_accepted"]),
            whole(found["num_right_above_wrong"]), whole(found["time_ms_p50"]), whole(found["time_ms_p95"]),
        ))  # fmt: skip
    head = ("method", "accepted and right", "of these, overlap below 0.3", "false accepts",
            "right, above every wrong one", "p50 [ms]", "p95 [ms]")  # fmt: skip
    return table(head, lines)


def candidates_table(results: Report) -> str:
    """Right candidates by overlap, accepted or not."""
    rows = read_rows(results["registration"])
    lines = []
    for method in methods_of(rows):
        bins = by_overlap(of_method(rows, method))
        lines.append((_told(method), *(f"{bins[b]['num_right']} of {bins[b]['num_pairs']}" for b, _, _ in BINS)))
    return table(("method", *(f"overlap {name}" for name, _, _ in BINS)), lines)


def overlap_table(results: Report) -> str:
    """Accepted and right, and false accepts, by overlap."""
    rows = read_rows(results["registration"])
    tables = {method: by_overlap(of_method(rows, method)) for method in methods_of(rows)}
    lines = [_line(name, [bins[name] for bins in tables.values()]) for name in (*(b[0] for b in BINS), NEGATIVES)]
    return table(("overlap", "pairs", *map(_told, tables)), lines)


def sensor_table(results: Report) -> str:
    """The same by kind of sensor; pairs of different places stand in lines of their own."""
    rows = read_rows(results["registration"])
    methods, lines = methods_of(rows), []
    for sensor, inside in grouped(rows, "sensor").items():
        for negative in (False, True):
            chosen = [row for row in inside if row["negative"] is negative]
            if chosen:
                name = f"{sensor}, {NEGATIVES}" if negative else sensor
                lines.append(_line(name, [count(of_method(chosen, method)) for method in methods]))
    return table(("sensor", "pairs", *map(_told, methods)), lines)


def criteria_table(results: Report) -> str:
    """What each method gets, and when its answer counts as accepted."""
    told = results["registration"].get("methods", {})
    methods = methods_of(read_rows(results["registration"]))
    lines = [(_told(m), *(told.get(m, {}).get(key, "") for key in ("prepared", "accepts"))) for m in methods]
    return table(("method", "gets", "accepted"), lines)


def registered_pairs(results: Report) -> str:
    """How many pairs the registrations are of, of how many sets, and of which commit."""
    report = results["registration"]
    rows = read_rows(report)
    first = of_method(rows, methods_of(rows)[0])
    num_negatives = sum(row["negative"] for row in first)
    pairs = f"{len(first) - num_negatives} pairs and {num_negatives} of {NEGATIVES}"
    limit = "" if report["limit"] is None else f", at most {report['limit']} a set and kind (walk: thrice)"
    changed = " with changes" if report["run"]["uncommitted"] else ""
    return f"{pairs} from {len(grouped(first, 'dataset'))} sets{limit}; commit {report['run']['commit'][:7]}{changed}"


SECTIONS = {
    "whole registrations": methods_table, "by overlap": candidates_table, "registrations by overlap": overlap_table,
    "registrations by sensor": sensor_table, "registration criteria": criteria_table,
    "registered pairs": registered_pairs,
}  # fmt: skip


def _told(method: str) -> str:
    return TOLD.get(method, method.replace("svc,", "`svc`,", 1))


def _line(name: str, counts: Sequence[Mapping[str, int]]) -> Sequence[str]:
    return (name, str(counts[0]["num_pairs"]), *map(_cell, counts))


def _cell(counts: Mapping[str, int]) -> str:
    wrong = counts["num_false_accepted"]
    return f"{counts['num_accepted_right']}" + (f", **{wrong} wrong**" if wrong else "")
