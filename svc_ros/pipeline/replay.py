"""A recorded bag through the same functions as the live node: what the replay decides, the node decides."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.registration import extract_features
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features
from svc_ros.io.bags import Bag
from svc_ros.io.point_cloud2 import scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.transforms import TransformTree
from svc_ros.pipeline.decide import refused, register_pair


@dataclass(frozen=True, eq=False)
class ReplayedPair:
    """The decision on two scans of a bag; indices count the clouds of the topic from 0, stamps are header stamps."""

    result: RegistrationResult
    source_index: int
    target_index: int
    source_stamp_ns: int
    target_stamp_ns: int
    source_frame: str
    target_frame: str


@dataclass(frozen=True, eq=False)
class _SeenScan:
    """One cloud of the bag: its features, or the error that it ended in."""

    index: int
    stamp_ns: int
    frame_id: str
    features: Features | None = None
    error: Exception | None = None


def replay_pairs(
    bag: Bag, topic: str, config: Config, stride: int = 1, sensor_frame: str | None = None
) -> Iterator[ReplayedPair]:
    """Register scan k + stride (source) to scan k (target) for every k, in the order of the bag.

    Each pair has exactly one decision: a cloud that cannot be read, has too few points or, with `sensor_frame`,
    no transform at its stamp makes its pairs rejected with that reason. Features are computed once a scan.
    `sensor_frame` names the frame of the sensor where the clouds are in another one (base_link); the origin of the
    sight lines then comes from the bag's transforms. Raises InputError for a stride below 1 and a broken bag.
    """
    if stride < 1:
        raise InputError(f"replay: expected a stride of at least 1, found {stride}")
    transforms = bag.transforms() if sensor_frame else None
    recent: deque[_SeenScan] = deque(maxlen=stride)
    for index, (_, msg) in enumerate(bag.raw_clouds(topic)):
        seen = _look_at(index, msg, config, transforms, sensor_frame)
        if len(recent) == stride:
            yield _decide(source=seen, target=recent[0], config=config)
        recent.append(seen)


def _look_at(
    index: int, msg: Any, config: Config, transforms: TransformTree | None, sensor_frame: str | None
) -> _SeenScan:
    seen = _SeenScan(index, ns_from_stamp(msg.header.stamp), str(msg.header.frame_id))
    try:
        origin = _sensor_origin(seen, transforms, sensor_frame)
        scan = scan_from_cloud(msg, sensor_origin=origin).scan
        return replace(seen, features=extract_features(scan, config))
    except (InputError, TransformUnavailableError) as error:
        return replace(seen, error=error)


def _sensor_origin(seen: _SeenScan, transforms: TransformTree | None, sensor_frame: str | None) -> Array | None:
    if transforms is None or sensor_frame is None:
        return None
    T_cloud_sensor = transforms.lookup(seen.frame_id, sensor_frame, seen.stamp_ns)
    origin: Array = T_cloud_sensor[:3, 3]
    return origin


def _decide(source: _SeenScan, target: _SeenScan, config: Config) -> ReplayedPair:
    return ReplayedPair(
        result=_result(source, target, config),
        source_index=source.index,
        target_index=target.index,
        source_stamp_ns=source.stamp_ns,
        target_stamp_ns=target.stamp_ns,
        source_frame=source.frame_id,
        target_frame=target.frame_id,
    )


def _result(source: _SeenScan, target: _SeenScan, config: Config) -> RegistrationResult:
    for role, seen in (("source", source), ("target", target)):
        if seen.error is not None:
            # the same class, so that it keeps its reason; the text says which of the two scans it was
            return refused(type(seen.error)(f"{role} (scan {seen.index}): {seen.error}"), config)
    assert source.features is not None  # a scan has features or an error
    assert target.features is not None
    return register_pair(source.features, target.features, config)
