"""A recorded bag through the same functions as the live node: what the replay decides, the node decides.

Here: the mode `pair`, which registers scans to earlier ones and keeps nothing else of them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import replace

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.registration import extract_features, prepare
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Features, PreparedScan
from svc_ros.io.bags import Bag
from svc_ros.pipeline.decide import refused, register_pair
from svc_ros.replay.clouds import BagPart, RecordedCloud, ReplayedPair, ReplayStep, Stopwatch, read_clouds
from svc_ros.replay.known import look_again


class SeenScan:
    """One cloud of the bag; what is computed of it, or the error that this ended in, is found when first asked for."""

    def __init__(self, cloud: RecordedCloud, config: Config) -> None:
        self.cloud, self._config = cloud, config
        self.prepared: PreparedScan | None = None
        self.features: Features | None = None
        self.error = cloud.error
        self.features_ms = 0.0

    def prepare(self) -> PreparedScan | None:
        """The scan as it is judged; None where `error` says why there is none."""
        if self.prepared is None and self.error is None:
            assert self.cloud.scan is not None  # a cloud has a scan or an error
            try:
                self.prepared = prepare(self.cloud.scan, self._config)
            except InputError as error:
                self.error = error
        return self.prepared

    def describe(self) -> Features | None:
        """What registration needs; None where `error` says why there is nothing."""
        scan = self.prepare()
        if self.features is None and scan is not None:
            self.features = extract_features(scan, self._config)
        return self.features


def replay_pairs(
    bag: Bag, topic: str, config: Config, stride: int = 1, sensor_frame: str | None = None
) -> Iterator[ReplayedPair]:
    """Register scan k + stride (source) to scan k (target) for every k, in the order of the bag.

    Each pair has exactly one decision: a cloud that cannot be read, has too few points or, with `sensor_frame`,
    no transform at its stamp makes its pairs rejected with that reason. Features are computed once a scan.
    sensor_frame: see `read_clouds`. Raises InputError for a stride below 1 and a broken bag.
    """
    clouds = read_clouds(bag, BagPart(topic, sensor_frame=sensor_frame))
    for step in pair_steps(see_scans(clouds, config), config, stride):
        yield from step.decisions


def see_scans(clouds: Iterable[RecordedCloud], config: Config, num_known: int = 0) -> Iterator[SeenScan]:
    """Compute the features of every cloud that a pair beyond the first `num_known` ones may need."""
    for cloud in clouds:
        seen, watch = SeenScan(cloud, config), Stopwatch()
        if cloud.index >= num_known:  # pair n has the clouds n and n + stride
            seen.describe()
            seen.features_ms = watch.ms()
        yield seen


def pair_steps(
    scans: Iterable[SeenScan], config: Config, stride: int = 1, known: Sequence[ReplayedPair] = ()
) -> Generator[ReplayStep]:
    """`replay_pairs` cloud by cloud. known: decisions on the first pairs from an earlier run, taken as they are.

    Raises InputError for a stride below 1.
    """
    if stride < 1:
        raise InputError(f"replay: expected a stride of at least 1, found {stride}")
    recent: deque[SeenScan] = deque(maxlen=stride)
    for seen in scans:
        watch, number = Stopwatch(), seen.cloud.index - stride
        decisions = []
        if 0 <= number < len(known):
            decisions = [_seen_again(known[number], seen, recent[0], config)]
        elif number >= 0:
            decisions = [_decide(seen, recent[0], config)]
        times = {"read": seen.cloud.read_ms, "features": seen.features_ms, "decide": watch.ms()}
        yield ReplayStep(seen.cloud, decisions, time_ms=times)
        recent.append(seen)


def _seen_again(known: ReplayedPair, source: SeenScan, target: SeenScan, config: Config) -> ReplayedPair:
    source_scan, target_scan = source.prepare(), target.prepare()
    if known.result.best_candidate is None or source_scan is None or target_scan is None:
        return known
    result = look_again(known.result, source_scan, target_scan, config)
    return replace(known, result=result, scans=(source_scan, target_scan))


def _decide(source: SeenScan, target: SeenScan, config: Config) -> ReplayedPair:
    result, scans = _result(source, target, config), None
    if result.best_candidate is not None and source.features is not None and target.features is not None:
        scans = source.features.prepared, target.features.prepared
    return ReplayedPair(
        result=result,
        source_stamp_ns=source.cloud.stamp_ns,
        target_stamp_ns=target.cloud.stamp_ns,
        source_frame=source.cloud.frame_id,
        target_frame=target.cloud.frame_id,
        origin="registration" if scans is not None else "",
        scans=scans,
        source_index=source.cloud.index,
        target_index=target.cloud.index,
    )


def _result(source: SeenScan, target: SeenScan, config: Config) -> RegistrationResult:
    for role, seen in (("source", source), ("target", target)):
        if seen.error is not None:
            # the same class, so that it keeps its reason; the text says which of the two scans it was
            return refused(type(seen.error)(f"{role} (scan {seen.cloud.index}): {seen.error}"), config)
    assert source.features is not None  # a scan has features or an error
    assert target.features is not None
    return register_pair(source.features, target.features, config)
