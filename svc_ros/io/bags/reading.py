"""Scans and transforms from recorded bags: ROS 1 (.bag) and ROS 2 (folder, .mcap, .db3), with no ROS installed.

Every failure of a bag, whatever library noticed it, is an InputError of one line that names the file and the cause.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, MissingDependencyError, SvcError
from svc_ros.core.se3 import Array, make_pose
from svc_ros.io.bags.result_writer import ResultWriter
from svc_ros.io.bags.writers import CloudBagWriter
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, CloudReading, scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.transforms import TransformTree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

__all__ = ["Bag", "CloudBagWriter", "ResultWriter", "TopicInfo", "UnreadableCloud", "pose_from_message"]

_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TF_TOPICS = {"tf": False, "tf_static": True}  # name -> holds static transforms
_QUATERNION_TOLERANCE = 0.01  # of its length, as tf2 has it
_STORAGE_SUFFIXES = (".mcap", ".db3")
_CLEARER = {  # how the reader words it -> what it means
    "end magic": "it is truncated, or its recording was not closed",
    "index looks damaged": "it is truncated, or its index is damaged",
    "not indexed": "its recording was not closed (`rosbag reindex` repairs that)",
    "File magic is invalid": "it is no bag",
    "seems to be empty": "it is empty",
    "Unrecognized storage format": "expected a .bag, .mcap or .db3 file or a ROS 2 bag folder",
    "missing tables": "it is empty or no ROS 2 recording",
}


@dataclass(frozen=True)
class TopicInfo:
    """One recorded topic; `type` as ROS 2 writes it, empty where messages of several types share the topic."""

    name: str
    type: str
    count: int


@dataclass(frozen=True)
class UnreadableCloud:
    """A cloud that was recorded but cannot be read as a scan: the index-th message of its topic, counted from 0."""

    index: int
    stamp_ns: int
    frame_id: str
    error: InputError


class Bag:
    """A recording, open between `with` and its end.

    paths: one ROS 2 folder, one .mcap or .db3 file, or one or several ROS 1 .bag files that were split. Compression
    of files and of messages is undone on the way. Raises InputError from `with` on for whatever is no complete bag.
    """

    def __init__(self, paths: str | Path | Sequence[str | Path]) -> None:
        given = [paths] if isinstance(paths, str | Path) else list(paths)
        self.paths = [Path(path) for path in given]
        self._name = ", ".join(str(path) for path in self.paths) or "bag"
        self._reader: AnyReader | None = None

    def __enter__(self) -> Bag:
        for path in self.paths:
            _check_bag_path(path)
        any_reader, store = _reader_and_types()
        with self._errors_named():
            reader = any_reader(self.paths, default_typestore=store)
            reader.open()
        self._reader = reader
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.close()

    @property
    def topics(self) -> list[TopicInfo]:
        """All recorded topics, by name."""
        found = sorted(self._open_reader().topics.items())
        return [TopicInfo(name, info.msgtype or "", info.msgcount) for name, info in found]

    @property
    def cloud_topics(self) -> list[TopicInfo]:
        """The topics of type PointCloud2."""
        return [topic for topic in self.topics if topic.type == CLOUD_TYPE]

    def resolve_cloud_topic(self, topic: str | None = None) -> str:
        """The name of the topic to read: the one asked for, or the only one with clouds.

        Raises InputError listing what was recorded if it is missing, holds no clouds, or several could be meant.
        """
        clouds = [info.name for info in self.cloud_topics]
        if topic is None:
            if len(clouds) == 1:
                return clouds[0]
            found = f"several ({', '.join(clouds)}): name one" if clouds else f"none among {self._listed_topics()}"
            raise InputError(f"{self._name}: expected one topic of type {CLOUD_TYPE}, found {found}")
        wanted = topic.lstrip("/")
        match = next((info for info in self.topics if info.name.lstrip("/") == wanted), None)
        if match is None:
            raise InputError(f"{self._name}: no topic {topic!r} (topics: {self._listed_topics()})")
        if match.type != CLOUD_TYPE:
            raise InputError(
                f"{self._name}: topic {match.name!r}: expected {CLOUD_TYPE}, found {match.type or 'several types'} "
                f"(clouds: {', '.join(clouds) or 'none'})"
            )
        return match.name

    def num_scans(self, topic: str | None = None) -> int:
        """Recorded clouds of a topic (None: of the only one)."""
        name = self.resolve_cloud_topic(topic)
        return next(info.count for info in self.topics if info.name == name)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times [ns] at which the first and the last message of the bag were recorded; (0, -1) without messages."""
        reader = self._open_reader()
        if reader.message_count == 0:
            return 0, -1
        return reader.start_time, reader.end_time - 1  # the reader tells the first time after it

    def raw_clouds(self, topic: str | None = None, span_ns: tuple[int, int] | None = None) -> Iterator[tuple[int, Any]]:
        """Yield (time [ns] at which it was recorded, PointCloud2) in the order of recording.

        span_ns: first and last time of recording that are wanted, both included.
        """
        name = self.resolve_cloud_topic(topic)
        for _, bag_time_ns, message in self._messages([name], (CLOUD_TYPE,), span_ns):
            yield bag_time_ns, message

    def scans(
        self, topic: str | None = None, on_error: Callable[[UnreadableCloud], None] | None = None
    ) -> Iterator[CloudReading]:
        """Yield every cloud as a scan with header stamp and frame, in the order of recording.

        A cloud that is no scan ends the iteration with InputError naming file, topic and index; with `on_error` it
        is handed to that function instead, and the next one follows. Damage of the file itself always raises.
        """
        name = self.resolve_cloud_topic(topic)
        for index, (_, message) in enumerate(self.raw_clouds(name)):
            try:
                reading = scan_from_cloud(message)
            except InputError as error:
                if on_error is None:
                    raise type(error)(f"{self._name}: {name}, cloud {index}: {error}") from None
                header = message.header
                on_error(UnreadableCloud(index, ns_from_stamp(header.stamp), str(header.frame_id), error))
                continue
            yield reading

    def transforms(self, max_gap_ns: int | None = None) -> TransformTree:
        """All of /tf and /tf_static as a tree; see TransformTree for `max_gap_ns`.

        A recorded transform that is impossible (no rotation, its own parent) is remembered: look-ups that need its
        frame are refused with the cause, all others work.
        """
        tree = TransformTree(max_gap_ns)
        for topic, _, message in self.transform_messages():
            for stamped in message.transforms:
                parent, child = str(stamped.header.frame_id), str(stamped.child_frame_id)
                stamp_ns = ns_from_stamp(stamped.header.stamp)
                try:
                    pose = pose_from_message(stamped.transform)
                    tree.add(parent, child, stamp_ns, pose, static=_TF_TOPICS[topic.lstrip("/")])
                except InputError as error:
                    tree.mark_faulty(child, f"{self._name}: {topic}: {parent} -> {child}: {error}")
        return tree

    def transform_messages(self) -> Iterator[tuple[str, int, Any]]:
        """Yield (topic, time [ns] at which it was recorded, TFMessage) of /tf and /tf_static."""
        names = [info.name for info in self.topics if info.name.lstrip("/") in _TF_TOPICS]
        yield from self._messages(names, _TF_TYPES)

    def _messages(
        self, topics: list[str], types: tuple[str, ...], span_ns: tuple[int, int] | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        reader = self._open_reader()
        wanted = [c for c in reader.connections if c.topic in topics and c.msgtype in types]
        if not wanted:  # the reader takes no connections for all of them
            return
        start, stop = (None, None) if span_ns is None else (span_ns[0], span_ns[1] + 1)
        with self._errors_named():
            for connection, bag_time_ns, raw in reader.messages(wanted, start, stop):
                yield connection.topic, bag_time_ns, reader.deserialize(raw, connection.msgtype)

    def _open_reader(self) -> AnyReader:
        if self._reader is None:
            raise InputError(f"{self._name}: the bag is not open; use it in a `with` block")
        return self._reader

    def _listed_topics(self) -> str:
        return ", ".join(f"{info.name} [{info.type or 'several types'}]" for info in self.topics) or "none"

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        """What the readers below raise has many types (storage, compression, typestore); a bag has one: InputError."""
        try:
            yield
        except SvcError:
            raise
        except Exception as error:
            words = " ".join(str(error).split()) or type(error).__name__
            cause = next((clear for raw, clear in _CLEARER.items() if raw in words), words)
            raise InputError(f"{self._name}: cannot be read as a bag: {cause}") from error


def pose_from_message(transform: Any) -> Array:
    """Pose (4, 4) of a geometry_msgs/Transform; InputError for numbers that are no rigid motion."""
    t, q = transform.translation, transform.rotation
    values = np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
    length = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or abs(length - 1.0) > _QUATERNION_TOLERANCE:
        raise InputError(f"expected finite numbers and a quaternion of length 1, found {values.tolist()}")
    return make_pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def _check_bag_path(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: bag not found")
    if path.is_dir() and not (path / "metadata.yaml").exists():
        inside = sorted(p.name for p in path.iterdir() if p.suffix in (*_STORAGE_SUFFIXES, ".bag"))
        hint = f"; open {inside[0]} itself" if inside else ""
        raise InputError(f"{path}: expected a ROS 2 bag folder with metadata.yaml, found none{hint}")


def _reader_and_types() -> tuple[type[AnyReader], Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError("reading bags needs rosbags: pip install 'rosbags>=0.11'") from None
    return AnyReader, get_typestore(Stores.ROS2_JAZZY)
