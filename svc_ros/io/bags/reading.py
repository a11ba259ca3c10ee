"""Scans and transforms from recorded bags: ROS 1 (.bag) and ROS 2 (folder, .mcap, .db3), with no ROS installed.

A damaged bag is read as far as it is intact, and tells its damage. What is no bag at all, whatever library noticed it,
is an InputError of one line that names the file and the cause.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import Array, make_pose
from svc_ros.io.bags.channels import Channel, Damage
from svc_ros.io.bags.decoding import UnreadableMessageError, decode
from svc_ros.io.bags.opening import OpenParts
from svc_ros.io.bags.result_writer import ResultWriter
from svc_ros.io.bags.writers import CloudBagWriter
from svc_ros.io.clouds.livox import LIVOX_TYPES
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, CloudReading, scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.transforms import TransformTree

__all__ = ["Bag", "CloudBagWriter", "Damage", "ResultWriter", "TopicInfo", "UnreadableCloud", "pose_from_message"]

_TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TF_TOPICS = {"tf": False, "tf_static": True}  # name -> holds static transforms
_QUATERNION_TOLERANCE = 0.01  # of its length, as tf2 has it
_CLOUD_TYPES = frozenset({CLOUD_TYPE, *LIVOX_TYPES})


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
    of files and of messages is undone on the way. A folder needs no metadata.yaml. What is cut, was not closed or is
    damaged is read as far as it is intact: see `damage`; a file without an index is gone through once, from `with` on.
    strict: damage is refused with InputError, whenever it is found.

    Raises InputError from `with` on for what is no bag, and for one of which no message is intact.
    """

    def __init__(self, paths: str | Path | Sequence[str | Path], strict: bool = False) -> None:
        given = [paths] if isinstance(paths, str | Path) else list(paths)
        self.paths, self.strict = [Path(path) for path in given], strict
        self._name = ", ".join(str(path) for path in self.paths) or "bag"
        self._parts: OpenParts | None = None
        self._damage: list[Damage] = []

    def __enter__(self) -> Bag:
        if not self.paths:
            raise InputError("bag: expected at least one path, found none")
        self._parts = OpenParts(self.paths, self.strict, (*_CLOUD_TYPES, *_TF_TYPES))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        parts, self._damage, self._parts = self._parts, self.damage, None
        if parts is not None:
            parts.close()

    @property
    def damage(self) -> list[Damage]:
        """What is cut or damaged, a file each, as far as it is known: a damaged chunk is found when it is read."""
        return self._damage if self._parts is None else self._parts.damage

    @property
    def topics(self) -> list[TopicInfo]:
        """All recorded topics, by name."""
        found: dict[str, list[Channel]] = {}
        for channel in sorted(self._open_parts().channels(), key=lambda channel: channel.topic):
            found.setdefault(channel.topic, []).append(channel)
        return [
            TopicInfo(name, _only({c.type for c in channels}), sum(c.num_messages for c in channels))
            for name, channels in found.items()
        ]

    @property
    def cloud_topics(self) -> list[TopicInfo]:
        """The topics of type PointCloud2, or of Livox' own."""
        return [topic for topic in self.topics if topic.type in _CLOUD_TYPES]

    def resolve_cloud_topic(self, topic: str | None = None) -> str:
        """The name of the topic to read: the one asked for, or the only one with clouds.

        Raises InputError listing what was recorded if it is missing, holds no clouds, or several could be meant.
        """
        clouds = [info.name for info in self.cloud_topics]
        if topic is None:
            if len(clouds) == 1:
                return clouds[0]
            found = f"several ({', '.join(clouds)}): name one" if clouds else f"none among {self._listed_topics()}"
            told = self._damage_told()
            raise InputError(f"{self._name}: expected one topic of type {CLOUD_TYPE}, found {found}{told}")
        wanted = topic.lstrip("/")
        match = next((info for info in self.topics if info.name.lstrip("/") == wanted), None)
        if match is None:
            told = self._damage_told()
            raise InputError(f"{self._name}: no topic {topic!r} (topics: {self._listed_topics()}){told}")
        if match.type not in _CLOUD_TYPES:
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
        spans = [part.span_ns for part in self._open_parts().parts]
        held = [(first, last) for first, last in spans if first <= last]
        return (min(first for first, _ in held), max(last for _, last in held)) if held else (0, -1)

    def raw_clouds(self, topic: str | None = None, span_ns: tuple[int, int] | None = None) -> Iterator[tuple[int, Any]]:
        """Yield (time [ns] at which it was recorded, PointCloud2) in the order of recording.

        Livox' own messages come as what has the attributes of a PointCloud2. What is damaged is left out: see `damage`.
        span_ns: first and last time of recording that are wanted, both included.
        """
        name = self.resolve_cloud_topic(topic)
        for _, bag_time_ns, message in self._messages([name], _CLOUD_TYPES, span_ns):
            yield bag_time_ns, message

    def scans(
        self, topic: str | None = None, on_error: Callable[[UnreadableCloud], None] | None = None
    ) -> Iterator[CloudReading]:
        """Yield every cloud as a scan with header stamp and frame, in the order of recording.

        A cloud that is no scan ends the iteration with InputError naming file, topic and index; with `on_error` it
        is handed to that function instead, and the next one follows. For damage of the file itself see `damage`.
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
        self, topics: Collection[str], types: Collection[str], span_ns: tuple[int, int] | None = None
    ) -> Iterator[tuple[str, int, Any]]:
        def wanted(channel: Channel) -> bool:
            return channel.topic in topics and channel.type in types

        for part, channel, bag_time_ns, raw in self._open_parts().messages(wanted, span_ns):
            try:
                message = decode(channel, raw)
            except UnreadableMessageError:
                part.mark_unreadable(channel.topic, bag_time_ns)
                continue
            yield channel.topic, bag_time_ns, message

    def _open_parts(self) -> OpenParts:
        if self._parts is None:
            raise InputError(f"{self._name}: the bag is not open; use it in a `with` block")
        return self._parts

    def _damage_told(self) -> str:
        return f"; {self.damage[0]}" if self.damage else ""

    def _listed_topics(self) -> str:
        return ", ".join(f"{info.name} [{info.type or 'several types'}]" for info in self.topics) or "none"


def pose_from_message(transform: Any) -> Array:
    """Pose (4, 4) of a geometry_msgs/Transform; InputError for numbers that are no rigid motion."""
    t, q = transform.translation, transform.rotation
    values = np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
    length = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or abs(length - 1.0) > _QUATERNION_TOLERANCE:
        raise InputError(f"expected finite numbers and a quaternion of length 1, found {values.tolist()}")
    return make_pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def _only(names: set[str]) -> str:
    """The one name; empty where there are several."""
    return next(iter(names)) if len(names) == 1 else ""
