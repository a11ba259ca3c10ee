"""What an interrupted replay has left, and whether another one may go on with it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.evaluation.replay_job import CONFIG, DECISIONS, RESULTS, SUMMARY, ReplayJob
from svc_ros.io.bags import Bag
from svc_ros.io.result_writer import NODE_NAME, RecordedTopic
from svc_ros.io.results import result_from_json
from svc_ros.pipeline.replay_clouds import ReplayedPair

_NAMES = (
    "source_stamp_ns", "target_stamp_ns", "source_frame", "target_frame", "origin", "source_index", "target_index",
)  # fmt: skip
_DECISION_TOPIC = f"/{NODE_NAME}/decision"


@dataclass(frozen=True, eq=False)
class Earlier:
    """What there is of an earlier run: lines of decisions.jsonl, results.mcap with just as many decisions, how many
    clouds of the input that holds, the time [s] it took, and the summary where nothing is left to do."""

    records: Sequence[Mapping[str, Any]] = ()
    results: Path | None = None
    num_clouds: int = 0
    wall_time_s: float = 0.0
    finished: Mapping[str, Any] = field(default_factory=dict)

    def messages(self) -> Iterator[tuple[RecordedTopic, int, bytes | memoryview]]:
        """Everything in results.mcap, with the time that it is about."""
        if self.results is None:
            return
        with Bag(self.results) as bag:
            for topic, time_ns, data in bag.serialised():
                yield RecordedTopic(topic.name, topic.type, topic.name == "/tf_static"), time_ns, data

    def decisions(self) -> list[ReplayedPair]:
        """The decisions, without their scans."""
        return [
            ReplayedPair(result_from_json(record), **{name: record[name] for name in _NAMES}) for record in self.records
        ]


def find_earlier(job: ReplayJob, topic: str, config_text: str) -> Earlier:
    """What `job.resume` may go on with; nothing where there was no run, or one that was killed before its files were
    complete. Raises InputError where the folder holds a run of another bag, mode or configuration."""
    if not job.resume or not (job.out / SUMMARY).is_file():
        return Earlier()
    summary = _read_object(job.out / SUMMARY)
    _check_same(job, topic, config_text, summary)
    if summary.get("state") == "complete":
        return Earlier(finished=summary)
    results = job.out / RESULTS
    if not results.is_file():
        return Earlier()
    with Bag(results) as bag:
        counts = {info.name: info.count for info in bag.topics}
    records = _first_lines(job.out / DECISIONS, counts.get(_DECISION_TOPIC, 0))
    if records is None:
        return Earlier()
    return Earlier(records, results, counts.get(topic, 0), float(summary.get("wall_time_s", 0.0)))


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


def _first_lines(path: Path, num: int) -> list[dict[str, Any]] | None:
    """That many records; None if there are fewer. What follows may be cut, because its writer was killed."""
    lines = path.read_text("utf-8").split("\n")[:-1] if path.is_file() else []
    return None if len(lines) < num else [json.loads(line) for line in lines[:num]]


def _read_object(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text("utf-8"))
    except ValueError:
        raise InputError(f"{path}: expected the summary of a replay, found no JSON") from None
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected the summary of a replay, found a {type(value).__name__}")
    return value
