"""The files that a replay fills while it runs: every decision is on disk as soon as it is made."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.io.bags.mcap_folder import CLOUD_TYPE
from svc_ros.io.bags.result_writer import RecordedTopic, ResultWriter
from svc_ros.io.results import json_line, result_to_json
from svc_ros.pipeline.agreement import ORIGIN
from svc_ros.replay.clouds import RecordedCloud, ReplayedPair
from svc_ros.replay.job import DECISIONS, RESULTS
from svc_ros.replay.pictures import draw
from svc_ros.replay.resume import Earlier
from svc_ros.replay.summary import Errors
from svc_ros.report.scenes import SceneKeeper

TRANSFORMS_TYPE = "tf2_msgs/msg/TFMessage"


class DecisionFiles:
    """decisions.jsonl and results.mcap, and the scenes for the report.

    The lines of an earlier run stay as they are; its decisions come by again, and go into all the rest.
    results.mcap appears when this is closed, also after an error.
    """

    def __init__(self, folder: Path, odometry_frame: str, earlier: Earlier) -> None:
        self._odometry_frame, self._earlier = odometry_frame, earlier
        self.num_seen, self._num_pairs = 0, 0
        self.scenes = SceneKeeper()
        with ExitStack() as opened:
            self._lines = opened.enter_context(_open_lines(folder / DECISIONS, bool(earlier.records)))
            self._results = opened.enter_context(ResultWriter(folder / RESULTS))
            self._opened = opened.pop_all()

    def write(self, decision: ReplayedPair, record: Mapping[str, Any]) -> None:
        """Take the next decision; record: its line."""
        number, self.num_seen = self.num_seen, self.num_seen + 1
        if number < len(self._earlier.records):
            self._earlier.check(number, record)
        else:
            self._lines.write(json_line(record) + "\n")
        stamps = decision.source_stamp_ns, decision.target_stamp_ns
        frames = decision.source_frame, decision.target_frame
        self._results.write(decision.result, *stamps, *frames, origin=decision.origin)
        picture = draw(decision, self._odometry_frame)
        if picture is not None:
            self._results.write_picture(picture, decision.source_stamp_ns)
        if decision.scans is not None:
            self.scenes.offer(self._num_pairs, *decision.scans, decision.result)
        self._num_pairs += decision.origin != ORIGIN

    def write_cloud(self, topic: str, cloud: RecordedCloud) -> None:
        """Copy the cloud itself."""
        self._results.write_recorded(RecordedTopic(topic, CLOUD_TYPE), cloud.bag_time_ns, cloud.message)

    def write_transforms(self, bag: Bag, span_ns: tuple[int, int]) -> None:
        """Copy /tf of that time and all of /tf_static."""
        for topic, time_ns, message in bag.transform_messages():
            is_static = topic.lstrip("/") == "tf_static"
            if is_static or span_ns[0] <= time_ns <= span_ns[1]:
                self._results.write_recorded(RecordedTopic(topic, TRANSFORMS_TYPE, is_static), time_ns, message)

    def __enter__(self) -> DecisionFiles:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()


def _open_lines(path: Path, go_on: bool) -> TextIO:
    """A file whose every line is on disk as soon as it is written; go_on: after the last whole line there is."""
    try:
        if go_on:
            os.truncate(path, path.read_bytes().rfind(b"\n") + 1)
        return path.open("a" if go_on else "w", encoding="utf-8", buffering=1)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def record_of(decision: ReplayedPair, with_reference: bool, errors: Errors | None) -> dict[str, Any]:
    """The line of decisions.jsonl; the errors are null where there is no reference for this decision."""
    extra: dict[str, Any] = {
        "source_stamp_ns": decision.source_stamp_ns,
        "target_stamp_ns": decision.target_stamp_ns,
        "source_index": decision.source_index,
        "target_index": decision.target_index,
        "source_frame": decision.source_frame,
        "target_frame": decision.target_frame,
        "origin": decision.origin,
        "T_odom_source": decision.T_odom_source,
    }
    if with_reference:
        rotation, translation = errors or (None, None)
        extra |= {"rotation_error_deg": rotation, "translation_error_m": translation}
    return result_to_json(decision.result, **extra)
