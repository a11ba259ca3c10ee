"""What a listener took down of one topic, in a folder: written where ROS is, read where it is not needed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import LIVOX_TYPE, cloud_from_cdr
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, CloudMessage

_NOTES = "heard.json"


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of the topic.

    node: with its namespace; reliability, durability: as in `best effort`, `transient local`; depth: 0 where the
    middleware does not tell it.
    """

    node: str
    type: str
    reliability: str
    durability: str
    depth: int = 0


@dataclass(frozen=True)
class Arrival:
    """One cloud as it came.

    received_ns: this machine's clock when the middleware had it; clock_ns: simulated time then, None where there is
    none; sequence: the publisher's number of it, None where the middleware does not tell.
    """

    received_ns: int
    stamp_ns: int
    frame_id: str
    num_points: int
    num_bytes: int
    sequence: int | None = None
    clock_ns: int | None = None


@dataclass(frozen=True)
class Heard:
    """Everything about one topic over some seconds.

    type: of its clouds, empty if nobody publishes clouds there; num_lost: messages that the middleware reported as
    lost; cloud_topics: all topics with clouds; num_nodes: other nodes that were seen; where: domain, discovery and
    middleware in words; cure: what to do against loss; kept: serialised messages by the number of their arrival.
    """

    topic: str
    seconds: float
    type: str = ""
    publishers: tuple[Endpoint, ...] = ()
    subscriptions: tuple[Endpoint, ...] = ()
    arrivals: tuple[Arrival, ...] = ()
    num_lost: int = 0
    cloud_topics: tuple[str, ...] = ()
    num_nodes: int = 0
    where: str = ""
    cure: str = ""
    kept: Mapping[int, bytes] = field(default_factory=dict)

    def clouds(self) -> Iterator[tuple[Arrival, CloudMessage]]:
        """The messages that were kept, as clouds, in the order of arrival."""
        from rosbags.typesys import Stores, get_typestore

        types = get_typestore(Stores.ROS2_JAZZY)
        for index, data in sorted(self.kept.items()):
            is_livox = self.type == LIVOX_TYPE
            cloud: Any = cloud_from_cdr(data) if is_livox else types.deserialize_cdr(data, CLOUD_TYPE)
            yield self.arrivals[index], cloud


def write_heard(folder: Path, heard: Heard) -> None:
    """Write notes and kept messages into a folder that exists."""
    for index, data in heard.kept.items():
        (folder / f"{index}.cdr").write_bytes(data)
    notes = dataclasses.asdict(dataclasses.replace(heard, kept={}))
    (folder / _NOTES).write_text(json.dumps(notes), encoding="utf-8")


def read_heard(folder: Path) -> Heard:
    """Read what `write_heard` wrote; InputError where there is nothing."""
    try:
        notes = json.loads((folder / _NOTES).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{folder}: expected the notes of a listener ({_NOTES}), found none") from None
    for name, kind in (("publishers", Endpoint), ("subscriptions", Endpoint), ("arrivals", Arrival)):
        notes[name] = tuple(kind(**values) for values in notes[name])
    notes["cloud_topics"] = tuple(notes["cloud_topics"])
    notes["kept"] = {int(path.stem): path.read_bytes() for path in folder.glob("*.cdr")}
    return Heard(**notes)
