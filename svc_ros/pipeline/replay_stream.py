"""A recorded bag through the modes that follow one stream of scans, as the live node feeds them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.io.bags import Bag
from svc_ros.io.point_cloud2 import scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.transforms import TransformTree
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.pipeline.stream import StreamDecision, refuse_scan

Odometry = Callable[[Scan], Array | None]


def replay_scan_matching(
    bag: Bag, topic: str, config: Config, sensor_frame: str | None = None
) -> Iterator[StreamDecision]:
    """Match every scan of a topic, in the order of the bag: one decision for each cloud, readable or not.

    sensor_frame: see `replay_pairs`. Raises InputError for a broken bag.
    """
    yield from _follow(bag, topic, config, ScanMatcher(config).add, sensor_frame)


def replay_loop_closure(
    bag: Bag, topic: str, closer: LoopCloser, odometry: Odometry, sensor_frame: str | None = None
) -> Iterator[StreamDecision]:
    """Look for loops among the scans of a topic; the closer then holds the keyframes. Raises InputError."""

    def add(scan: Scan) -> list[StreamDecision]:
        return closer.add(scan, odometry(scan))

    yield from _follow(bag, topic, closer.config, add, sensor_frame)


def odometry_by_matching(config: Config) -> Odometry:
    """Odometry by scan matching; no pose where that is not sure of one. To be asked for every scan, in order."""
    matcher = ScanMatcher(config)

    def pose(scan: Scan) -> Array | None:
        return matcher.add(scan)[0].T_odom_source

    return pose


def odometry_by_transforms(transforms: TransformTree, odometry_frame: str) -> Odometry:
    """Odometry as recorded on /tf; no pose where the tree has none at the scan's stamp."""

    def pose(scan: Scan) -> Array | None:
        try:
            return transforms.lookup(odometry_frame, scan.frame_id, scan.stamp_ns)
        except TransformUnavailableError:
            return None

    return pose


def _follow(
    bag: Bag, topic: str, config: Config, add: Callable[[Scan], list[StreamDecision]], sensor_frame: str | None
) -> Iterator[StreamDecision]:
    transforms = bag.transforms() if sensor_frame else None
    for _, message in bag.raw_clouds(topic):
        stamp_ns, frame_id = ns_from_stamp(message.header.stamp), str(message.header.frame_id)
        try:
            scan = _scan_from(message, transforms, sensor_frame)
        except (InputError, TransformUnavailableError) as error:
            yield refuse_scan(stamp_ns, frame_id, error, config)
            continue
        yield from add(scan)


def _scan_from(message: Any, transforms: TransformTree | None, sensor_frame: str | None) -> Scan:
    origin: Array | None = None
    if transforms is not None and sensor_frame is not None:
        stamp_ns = ns_from_stamp(message.header.stamp)
        origin = transforms.lookup(str(message.header.frame_id), sensor_frame, stamp_ns)[:3, 3]
    return scan_from_cloud(message, sensor_origin=origin).scan
