"""What a node under load told, and what is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SUMMED = ("received", "lost", "jobs", "decisions", "reasons", "latency_ms", "output")
MAX_LATE_MS = 25.0  # 99th percentile of a 100 Hz timer in the node's process
MAX_KEYFRAMES = 4  # that the node may keep
MAX_GROWTH_MB = 60.0  # of the resident set, from the middle third of the load to its last


@dataclass(frozen=True)
class Snapshot:
    """One answer of ~/status: which verdicts had come here before it was asked for, and how much was published."""

    status: Mapping[str, Any]
    decided_before: Mapping[str, int]
    published: int


@dataclass
class Record:
    """Everything that was seen of one mode from outside. resident_mb: one sample a second under load."""

    mode: str
    queue_size: int
    snapshots: list[Snapshot] = field(default_factory=list)
    decided: Counter[str] = field(default_factory=Counter)
    resident_mb: list[float] = field(default_factory=list)
    late_ms: list[float] = field(default_factory=list)
    served_per_s: float = 0.0
    played_per_s: float = 0.0
    is_alive: bool = True


def wrong_counts(snapshot: Snapshot, queue_size: int) -> list[str]:
    """What does not add up at one moment; each line names both sides."""
    status, jobs, verdicts = snapshot.status, snapshot.status["jobs"], snapshot.status["decisions"]
    decided, received = sum(verdicts.values()), status["received"]
    sums = {"jobs received": (jobs["received"], jobs["pending"] + jobs["without_candidate"] + decided)}
    if "points" in received:
        sums["scans received"] = (received["points"], jobs["received"])
    else:
        pairing = status["pairing"]
        split = 2 * pairing["matched"] + pairing["unmatched"] + pairing["waiting"]
        sums["clouds received"] = (received["source"] + received["target"], split)
        sums["pairs received"] = (pairing["matched"] + pairing["unmatched"], jobs["received"])
    wrong = [f"{name}: {left} is not {right}" for name, (left, right) in sums.items() if left != right]
    if sum(received.values()) > snapshot.published:
        wrong.append(f"received {sum(received.values())} clouds of {snapshot.published} published")
    if status["worker"]["queue"] > queue_size:
        wrong.append(f"queue: {status['worker']['queue']} wait, {queue_size} may")
    if status["worker"].get("keyframes", 0) > MAX_KEYFRAMES:
        wrong.append(f"keyframes: {status['worker']['keyframes']} are kept, {MAX_KEYFRAMES} may")
    ahead = {name: n for name, n in snapshot.decided_before.items() if n > verdicts[name]}
    return [*wrong, *(f"{name}: {n} came out, {verdicts[name]} were counted" for name, n in ahead.items())]


def growth_mb(resident_mb: Sequence[float]) -> float:
    """Largest resident set in the last third less that in the middle third; NaN for fewer than six samples."""
    third = len(resident_mb) // 3
    if third < 2:
        return float("nan")
    return float(max(resident_mb[-third:]) - max(resident_mb[third:-third]))


def checks(record: Record) -> dict[str, bool]:
    """What has to hold, by name."""
    last = record.snapshots[-1].status
    return {
        "counts_right_at_every_moment": not any(wrong_counts(s, record.queue_size) for s in record.snapshots),
        "every_decision_came_out": dict(record.decided) == {k: n for k, n in last["decisions"].items() if n},
        "nothing_left_undone": last["jobs"]["pending"] == 0 and last["output"]["waiting"] == 0,
        "more_was_played_than_served": last["reasons"].get("superseded", 0) > 0,
        "memory_bounded": not growth_mb(record.resident_mb) > MAX_GROWTH_MB,
        "timer_in_time": bool(record.late_ms) and float(np.percentile(record.late_ms, 99)) < MAX_LATE_MS,
        "alive": record.is_alive,
    }


def summary(record: Record) -> dict[str, Any]:
    """The numbers of one mode, for the report."""
    last = record.snapshots[-1]
    late = np.array(record.late_ms) if record.late_ms else np.array([np.nan])
    wrong = [line for s in record.snapshots for line in wrong_counts(s, record.queue_size)]
    return {
        "served_per_s": record.served_per_s, "played_per_s": record.played_per_s, "published": last.published,
        **{name: last.status[name] for name in SUMMED},
        "snapshots": len(record.snapshots), "wrong_counts": wrong[:10],
        "queue_max": max(s.status["worker"]["queue"] for s in record.snapshots),
        "output_waiting_max": max(s.status["output"]["waiting"] for s in record.snapshots),
        "pending_max": max(s.status["jobs"]["pending"] for s in record.snapshots),
        "resident_mb": record.resident_mb, "growth_mb": growth_mb(record.resident_mb),
        "late_ms_p50": float(np.percentile(late, 50)), "late_ms_p99": float(np.percentile(late, 99)),
        "late_ms_max": float(late.max()), "ticks": len(record.late_ms), "checks": checks(record),
    }  # fmt: skip
