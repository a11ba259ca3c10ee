"""What an interrupted replay has left, and whether another one may go on with it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.io.results import result_from_json
from svc_ros.replay.clouds import ReplayedPair
from svc_ros.replay.job import CONFIG, DECISIONS, SUMMARY, ReplayJob

_NAMES = (
    "source_stamp_ns", "target_stamp_ns", "source_frame", "target_frame", "origin", "source_index", "target_index",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Earlier:
    """What there is of an earlier run: the lines of decisions.jsonl, the time [s] it took, and its whole summary where
    nothing is left to do."""

    records: Sequence[Mapping[str, Any]] = ()
    wall_time_s: float = 0.0
    finished: Mapping[str, Any] = field(default_factory=dict)

    def decisions(self) -> list[ReplayedPair]:
        """The decisions, without their scans."""
        return [
            ReplayedPair(result_from_json(record), **{name: record[name] for name in _NAMES}) for record in self.records
        ]

    def check(self, number: int, record: Mapping[str, Any]) -> None:
        """Raise InputError unless a decision that was made again is the one that was made before."""
        for name in (*_NAMES, "verdict", "reason", "best_candidate"):
            if record[name] != self.records[number].get(name):
                raise InputError(
                    f"--resume: decision {number} has {name} {record[name]!r:.60}, the earlier run found "
                    f"{self.records[number].get(name)!r:.60}: it cannot be continued"
                )


def find_earlier(job: ReplayJob, topic: str, config_text: str) -> Earlier:
    """What `job.resume` may go on with; nothing where there was no run.

    A run that was killed counts, too: its last line may be cut, and is forgotten. Raises InputError where the folder
    holds a run of another bag, mode or configuration.
    """
    if not job.resume or not (job.out / SUMMARY).is_file():
        return Earlier()
    summary = _parsed((job.out / SUMMARY).read_text("utf-8"), f"{job.out / SUMMARY}")
    _check_same(job, topic, config_text, summary)
    if summary.get("state") == "complete":
        return Earlier(finished=summary)
    path = job.out / DECISIONS
    lines = path.read_text("utf-8").split("\n")[:-1] if path.is_file() else []
    records = [_parsed(line, f"{path}:{number}") for number, line in enumerate(lines, 1)]
    return Earlier(records, float(summary.get("wall_time_s", 0.0)))


def _check_same(job: ReplayJob, topic: str, config_text: str, summary: Mapping[str, Any]) -> None:
    """Refuse to go on with what another job began."""
    wanted, found = {**job.identity(), "topic": topic}, summary.get("run") or {}
    if different := [name for name in wanted if wanted[name] != found.get(name)]:
        name = different[0]
        raise InputError(
            f"--resume: {job.out} holds a run with another {name}: {found.get(name)!r:.60}, found {wanted[name]!r:.60}"
        )
    config = job.out / CONFIG
    if not config.is_file() or config.read_text("utf-8") != config_text:
        raise InputError(f"--resume: {job.out} holds a run with another configuration: see {config}")


def _parsed(text: str, place: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except ValueError:
        raise InputError(f"{place}: expected a JSON object of an earlier replay, found none") from None
    if not isinstance(value, dict):
        raise InputError(f"{place}: expected a JSON object of an earlier replay, found a {type(value).__name__}")
    return value
