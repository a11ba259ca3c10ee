"""Recorded clouds in the order of the bag, and what each of them led to; every mode of the replay begins here."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.io.bags import Bag
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.transforms import TransformTree
from svc_ros.pipeline.stream import StreamDecision

_NS = 1_000_000_000


@dataclass(frozen=True)
class BagPart:
    """Which clouds of a bag are replayed: from `start_s` [s] after the bag's begin on, for `duration_s` (None: all),
    every `stride`-th of them, on the topic `topic`; `sensor_frame`: see `read_clouds`."""

    topic: str
    start_s: float = 0.0
    duration_s: float | None = None
    stride: int = 1
    sensor_frame: str | None = None

    def __post_init__(self) -> None:
        if self.stride < 1:
            raise InputError(f"replay: expected a stride of at least 1, found {self.stride}")
        if not self.start_s >= 0.0:
            raise InputError(f"replay: expected a start of at least 0 s, found {self.start_s:g}")
        if self.duration_s is not None and not self.duration_s > 0.0:
            raise InputError(f"replay: expected a duration above 0 s, found {self.duration_s:g}")

    def span_ns(self, bag: Bag) -> tuple[int, int]:
        """First and last time of recording [ns] that belong to it, cut to the bag; InputError if that is nothing."""
        begin, end = bag.span_ns
        if begin > end:
            raise InputError("replay: expected messages in the bag, found none")
        first = begin + round(self.start_s * _NS)
        if first > end:
            raise InputError(f"replay: the bag has {(end - begin) / _NS:.1f} s, and is to start at {self.start_s:g} s")
        return first, end if self.duration_s is None else min(end, first + round(self.duration_s * _NS) - 1)


@dataclass(frozen=True, eq=False)
class RecordedCloud:
    """One cloud of the replay: the index counts from 0; `scan` is None where `error` says why it is none; read_ms:
    from the message's bytes to the scan."""

    index: int
    stamp_ns: int
    frame_id: str
    bag_time_ns: int
    message: Any
    read_ms: float = 0.0
    scan: Scan | None = None
    error: InputError | TransformUnavailableError | None = None


@dataclass(frozen=True, eq=False)
class ReplayedPair(StreamDecision):
    """The decision on two clouds of a bag; indices count the clouds of the replay from 0, stamps are header stamps."""

    source_index: int = -1
    target_index: int = -1

    @classmethod
    def of(cls, decision: StreamDecision, source_index: int, target_index: int) -> ReplayedPair:
        """The decision of a stream with the indices of its clouds."""
        return cls(**{**vars(decision), "source_index": source_index, "target_index": target_index})


@dataclass(frozen=True, eq=False)
class ReplayStep:
    """What one cloud led to. T_odom_scan: (4, 4), where it stands in the odometry frame, in the modes that have one and
    where it is known; time_ms: wall time of the stages that every cloud goes through, by name."""

    cloud: RecordedCloud
    decisions: list[ReplayedPair] = field(default_factory=list)
    T_odom_scan: Array | None = None
    time_ms: Mapping[str, float] = field(default_factory=dict)


class Stopwatch:
    """Milliseconds since it was made."""

    def __init__(self) -> None:
        self._begun = time.perf_counter()

    def ms(self) -> float:
        """What has passed [ms]."""
        return 1e3 * (time.perf_counter() - self._begun)


def read_clouds(bag: Bag, part: BagPart) -> Iterator[RecordedCloud]:
    """Read clouds as scans, in the order of recording; one that cannot be read says why, and the next one follows.

    `part.sensor_frame` names the frame of the sensor where the clouds are in another one (base_link); the origin of
    the sight lines then comes from the bag's transforms. Raises InputError for a broken bag.
    """
    transforms = bag.transforms() if part.sensor_frame else None
    for number, (bag_time_ns, message) in enumerate(bag.raw_clouds(part.topic, part.span_ns(bag))):
        if number % part.stride == 0:
            watch = Stopwatch()
            stamp_ns, frame_id = ns_from_stamp(message.header.stamp), str(message.header.frame_id)
            cloud = RecordedCloud(number // part.stride, stamp_ns, frame_id, bag_time_ns, message)
            yield _read(cloud, transforms, part.sensor_frame, watch)


def first_scans(bag: Bag, part: BagPart, num: int) -> list[Scan]:
    """The first `num` clouds that can be read and have points; fewer where there are no more. As `read_clouds`."""
    scans = (cloud.scan for cloud in read_clouds(bag, part))
    return list(islice((scan for scan in scans if scan is not None and len(scan)), num))


def _read(
    cloud: RecordedCloud, transforms: TransformTree | None, sensor_frame: str | None, watch: Stopwatch
) -> RecordedCloud:
    try:
        origin: Array | None = None
        if transforms is not None and sensor_frame is not None:
            origin = transforms.lookup(cloud.frame_id, sensor_frame, cloud.stamp_ns)[:3, 3]
        scan = scan_from_cloud(cloud.message, sensor_origin=origin).scan
        return replace(cloud, scan=scan, read_ms=watch.ms())
    except (InputError, TransformUnavailableError) as error:
        return replace(cloud, error=error, read_ms=watch.ms())
