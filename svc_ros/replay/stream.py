"""A recorded bag through the modes that follow one stream of scans, as the live node feeds them."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.io.bags import Bag
from svc_ros.io.transforms import TransformTree
from svc_ros.pipeline.localisation import Localiser
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.neighbours import KeyframeMap
from svc_ros.pipeline.scan_matching import ScanMatcher
from svc_ros.pipeline.stream import StampOrder, StreamDecision, refuse_scan
from svc_ros.replay.clouds import BagPart, RecordedCloud, ReplayedPair, ReplayStep, Stopwatch, read_clouds

Odometry = Callable[[Scan], Array | None]


@dataclass(frozen=True, eq=False)
class TrackedCloud:
    """A cloud with its place in the odometry frame, T_odom_scan (4, 4), if odometry knows; odometry_ms: its time."""

    cloud: RecordedCloud
    T_odom_scan: Array | None
    odometry_ms: float


def replay_scan_matching(
    bag: Bag, topic: str, config: Config, sensor_frame: str | None = None
) -> Iterator[StreamDecision]:
    """Match every scan of a topic, in the order of the bag: one decision for each cloud, readable or not.

    sensor_frame: see `read_clouds`. Raises InputError for a broken bag.
    """
    for step in matching_steps(read_clouds(bag, BagPart(topic, sensor_frame=sensor_frame)), config):
        yield from step.decisions


def replay_loop_closure(
    bag: Bag, topic: str, closer: LoopCloser, odometry: Odometry, sensor_frame: str | None = None
) -> Iterator[StreamDecision]:
    """Look for loops among the scans of a topic; the closer then holds the keyframes. Raises InputError."""
    clouds = read_clouds(bag, BagPart(topic, sensor_frame=sensor_frame))
    for step in loop_steps(track_clouds(clouds, odometry), closer):
        yield from step.decisions


def matching_steps(clouds: Iterable[RecordedCloud], config: Config) -> Generator[ReplayStep]:
    """`replay_scan_matching` cloud by cloud."""
    matcher, indices = ScanMatcher(config), _Indices()
    for cloud in clouds:
        watch = Stopwatch()
        found = matcher.add(cloud.scan) if cloud.scan is not None else [_refused(cloud, config)]
        decisions = indices.of(found, cloud)
        yield ReplayStep(cloud, decisions, found[0].T_odom_source, {"read": cloud.read_ms, "decide": watch.ms()})


def track_clouds(clouds: Iterable[RecordedCloud], odometry: Odometry) -> Iterator[TrackedCloud]:
    """Ask odometry about every cloud that can be read, in order."""
    for cloud in clouds:
        watch = Stopwatch()
        T_odom_scan = None if cloud.scan is None else odometry(cloud.scan)
        yield TrackedCloud(cloud, T_odom_scan, watch.ms())


def loop_steps(clouds: Iterable[TrackedCloud], closer: LoopCloser) -> Generator[ReplayStep]:
    """`replay_loop_closure` cloud by cloud; most clouds have no decision."""
    indices = _Indices()
    for tracked in clouds:
        watch, cloud = Stopwatch(), tracked.cloud
        found = _closed(tracked, closer)
        times = {"read": cloud.read_ms, "odometry": tracked.odometry_ms, "decide": watch.ms()}
        yield ReplayStep(cloud, indices.of(found, cloud), tracked.T_odom_scan, times)


def localisation_steps(clouds: Iterable[TrackedCloud], localiser: Localiser) -> Generator[ReplayStep]:
    """Find every cloud in a map: one decision each, whose target index is that of a keyframe of the map."""
    keyframes = localiser.keyframes
    for tracked in clouds:
        watch, cloud = Stopwatch(), tracked.cloud
        if cloud.scan is None:
            localiser.pass_over(cloud.stamp_ns)
            found = [_refused(cloud, localiser.config)]
        else:
            found = localiser.add(cloud.scan, tracked.T_odom_scan)
        decisions = [ReplayedPair.of(d, cloud.index, _keyframe_number(keyframes, d, cloud)) for d in found]
        times = {"read": cloud.read_ms, "odometry": tracked.odometry_ms, "decide": watch.ms()}
        yield ReplayStep(cloud, decisions, decisions[-1].T_odom_source, times)


def _keyframe_number(keyframes: KeyframeMap, decision: StreamDecision, cloud: RecordedCloud) -> int:
    """Which keyframe of the map is the target: stamps alone do not tell, where runs of one time were joined."""
    if decision.T_odom_target is None:
        return cloud.index
    of_stamp = np.flatnonzero(keyframes.stamps_ns == decision.target_stamp_ns)
    is_there = (keyframes.poses[of_stamp] == decision.T_odom_target).all((1, 2))
    return int(of_stamp[np.argmax(is_there)])


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


def _closed(tracked: TrackedCloud, closer: LoopCloser) -> list[StreamDecision]:
    if tracked.cloud.scan is None:
        return [_refused(tracked.cloud, closer.config)]
    return closer.add(tracked.cloud.scan, tracked.T_odom_scan)


class _Indices:
    """Which cloud had which stamp, since time last jumped back."""

    def __init__(self) -> None:
        self._order = StampOrder()
        self._of_stamp: dict[int, int] = {}

    def of(self, decisions: list[StreamDecision], cloud: RecordedCloud) -> list[ReplayedPair]:
        """The decisions that a cloud led to with the indices of both clouds. Of two clouds with one stamp the later is
        dropped, so that a target is the first one."""
        if self._order.is_jump(cloud.stamp_ns):
            self._of_stamp.clear()
        self._order.lateness(cloud.stamp_ns)
        self._of_stamp.setdefault(cloud.stamp_ns, cloud.index)
        return [
            ReplayedPair.of(d, self._index(d.source_stamp_ns, cloud), self._index(d.target_stamp_ns, cloud))
            for d in decisions
        ]

    def _index(self, stamp_ns: int, cloud: RecordedCloud) -> int:
        """cloud: the one that led to the decision; what was compared with nothing is its own target."""
        return cloud.index if stamp_ns == cloud.stamp_ns else self._of_stamp[stamp_ns]


def _refused(cloud: RecordedCloud, config: Config) -> StreamDecision:
    assert cloud.error is not None  # a cloud has a scan or an error
    return refuse_scan(cloud.stamp_ns, cloud.frame_id, cloud.error, config)
