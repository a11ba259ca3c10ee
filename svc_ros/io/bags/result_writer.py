"""Decisions as one MCAP file with the topics of the node, for RViz, Foxglove and every other bag tool.

Messages are stamped with the time of the scan that they are about, never with the time of writing.
"""

from __future__ import annotations

import contextlib
import json
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.io.bags.mcap_folder import CLOUD_TYPE, POSE_TYPE, TRANSFORM_TYPE, McapFolder
from svc_ros.io.bags.pictures import MARKERS_TYPE, Picture, marker_array
from svc_ros.io.bags.writers import checked_stamp, distinct_frames
from svc_ros.io.config_yaml import NODE_NAME
from svc_ros.io.results import UNKNOWN_COVARIANCE, decision_values

RESULT_TOPICS = {
    "transform": TRANSFORM_TYPE,
    "pose": POSE_TYPE,
    "rejected": "std_msgs/msg/Bool",
    "decision": "diagnostic_msgs/msg/DiagnosticArray",
}
PICTURE_TOPICS = {"aligned": CLOUD_TYPE, "blocked_points": CLOUD_TYPE, "sight_lines": MARKERS_TYPE}
UNFINISHED = ".*.unfinished"  # what the folder is called that holds a file until it is closed


class RecordedTopic(NamedTuple):
    """A topic of a bag; latched: offered to late subscribers (/tf_static)."""

    name: str
    type: str
    latched: bool = False


class ResultWriter:
    """Decisions as one MCAP file with the topics of the node, `/svc_registration/...`:

    transform (TransformStamped, accepted only; header.frame_id = target's frame, child_frame_id = source's),
    pose (PoseWithCovarianceStamped, accepted only; UNKNOWN_COVARIANCE where the method gives none), rejected (Bool)
    and decision (DiagnosticArray, level OK if accepted, else WARN) for every pair. Scans of one sensor share one
    frame: the child is then named `FRAME/source`, because a frame cannot be its own parent; a scan without a frame is
    called `target` or `source`. `write_picture` adds aligned and blocked_points (PointCloud2) and sight_lines
    (MarkerArray), `write_recorded` messages of other topics.

    The file appears when the writer is closed, also after an error, and replaces an older one.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix != ".mcap" or self.path.is_dir():
            raise InputError(f"{path}: expected the name of an .mcap file")
        self._workplace = contextlib.ExitStack()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            folder = self._workplace.enter_context(
                tempfile.TemporaryDirectory(dir=self.path.parent, prefix=f".{self.path.stem}-", suffix=".unfinished")
            )
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._folder = Path(folder, "bag")  # the library writes a folder, of which the one file is taken
        self._bag = McapFolder(self._folder, compress=True)
        for name, msgtype in RESULT_TOPICS.items():
            self._bag.add_topic(f"/{NODE_NAME}/{name}", msgtype, latched=name == "decision")

    def write(
        self,
        result: RegistrationResult,
        source_stamp_ns: int,
        target_stamp_ns: int,
        source_frame: str = "",
        target_frame: str = "",
        origin: str = "",
    ) -> None:
        """Write one decision, stamped with the source's time; stamps beyond 32 bits of seconds raise InputError.

        origin: where the judged pose came from, where a mode tells.
        """
        stamp = checked_stamp(source_stamp_ns)
        parent, child = distinct_frames(target_frame, source_frame)
        header, bag = self._bag.header(stamp, parent), self._bag
        if result.T_target_source is not None:
            self._put("transform", stamp, bag.transform(header, child, result.T_target_source))
            covariance = UNKNOWN_COVARIANCE if result.covariance is None else result.covariance
            self._put("pose", stamp, bag.pose(header, result.T_target_source, covariance))
        self._put("rejected", stamp, bag.make(RESULT_TOPICS["rejected"], data=not result.accepted))
        values = decision_values(result, source_stamp_ns, target_stamp_ns)
        values |= {"source_frame": source_frame, "target_frame": target_frame}
        for name, T in (("T_target_source", result.T_target_source), ("best_candidate", result.best_candidate)):
            values[name] = "" if T is None else json.dumps(T.tolist())
        if origin:
            values["origin"] = origin
        message = f"{result.verdict.value}: {result.reason.value}"
        status = bag.status(f"{NODE_NAME}: decision", "OK" if result.accepted else "WARN", message, values)
        self._put("decision", stamp, bag.make(RESULT_TOPICS["decision"], header=header, status=[status]))

    def write_picture(self, picture: Picture, stamp_ns: int) -> None:
        """Write what there is to look at, stamped with the source's time."""
        stamp, bag = checked_stamp(stamp_ns), self._bag
        header = bag.header(stamp, picture.frame_id)
        for name, msgtype in PICTURE_TOPICS.items():
            self._declare(f"/{NODE_NAME}/{name}", msgtype)
        if picture.aligned is not None:
            self._put("aligned", stamp, bag.cloud(header, picture.aligned))
        self._put("blocked_points", stamp, bag.cloud(header, picture.blocked, {"from_source": picture.from_source}))
        self._put("sight_lines", stamp, marker_array(bag, picture, stamp))

    def write_recorded(self, topic: RecordedTopic, time_ns: int, message: Any) -> None:
        """Write a message as it was read from a bag, of ROS 1 or ROS 2, with the time at which it was recorded."""
        self._declare(topic.name, topic.type, topic.latched)
        self._bag.write(topic.name, checked_stamp(time_ns), message)

    def close(self) -> None:
        """Finish the file and put it in its place; a second call does nothing."""
        if self._folder.is_dir():
            with self._workplace:
                self._bag.close()
                (self._folder / f"{self._folder.name}.mcap").replace(self.path)

    def _declare(self, topic: str, msgtype: str, latched: bool = False) -> None:
        if topic not in self._bag.connections:
            self._bag.add_topic(topic, msgtype, latched)

    def _put(self, name: str, stamp_ns: int, message: Any) -> None:
        self._bag.write(f"/{NODE_NAME}/{name}", stamp_ns, message)

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
