"""A pair of clouds becomes a decision; what was computed of a cloud is kept for its next pair. No rclpy here."""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.registration import extract_features, verify
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features, Scan
from svc_ros.io.point_cloud2 import scan_from_cloud
from svc_ros.pipeline.decide import dropped, refused, register_pair
from svc_ros.ros.worker import Cloud, CloudLabel, DropJob, Job

_CACHED_SCANS = 3  # both of the last pair, and one that is on its way


@dataclass(frozen=True, eq=False)
class ScanWork:
    """What was computed of one cloud."""

    scan: Scan
    features: Features


@dataclass(frozen=True, eq=False)
class Decision:
    """The answer to one job, with what its publishers may want to show."""

    result: RegistrationResult
    source: CloudLabel | None
    target: CloudLabel | None
    timings_ms: dict[str, float] = field(default_factory=dict)
    source_work: ScanWork | None = None
    target_work: ScanWork | None = None


class PairRegistrar:
    """Turns jobs into decisions, and reuses the features of a cloud that comes again.

    origin_of: where the sensor stood in the frame of a cloud, (frame, stamp_ns) -> (3,) [m]; guess_of: a pose
    (4, 4) to try first for a source stamp, or None. Belongs to one thread.
    """

    def __init__(
        self, origin_of: Callable[[str, int], Array], guess_of: Callable[[int], Array | None] = lambda _stamp: None
    ) -> None:
        self._origin_of, self._guess_of = origin_of, guess_of
        self._cache: OrderedDict[tuple[Any, ...], ScanWork] = OrderedDict()
        self.num_reused = 0

    def decide(self, job: Job, config: Config) -> Decision:
        """The decision on one job; never raises."""
        if isinstance(job, DropJob):
            return Decision(dropped(job.reason, job.detail, config.method), job.source, job.target)
        start = time.monotonic()
        timings = {"queue_ms": 1e3 * (start - max(job.source.received_s, job.target.received_s))}
        works: list[ScanWork] = []
        try:
            works = [self._work("source", job.source, config), self._work("target", job.target, config)]
            timings["features_ms"] = 1e3 * (time.monotonic() - start)
            result = self._register(works[0].features, works[1].features, job.source.stamp_ns, config)
        except Exception as error:
            result = refused(error, config)
        timings["latency_ms"] = 1e3 * (time.monotonic() - max(job.source.received_s, job.target.received_s))
        return Decision(result, job.source.label, job.target.label, timings, *works)

    def forget(self) -> None:
        """Drop the cached features."""
        self._cache.clear()

    def _register(self, source: Features, target: Features, stamp_ns: int, config: Config) -> RegistrationResult:
        guess = self._guess_of(stamp_ns)
        if guess is not None:
            verified = verify(source, target, guess, config)
            if verified.accepted:
                return verified
        return register_pair(source, target, config)

    def _work(self, side: str, cloud: Cloud, config: Config) -> ScanWork:
        try:
            origin = self._origin_of(str(cloud.message.header.frame_id), cloud.stamp_ns)
            key = (_fingerprint(cloud.message), tuple(origin.tolist()), config)
            if key in self._cache:
                self.num_reused += 1
                self._cache.move_to_end(key)
                return self._cache[key]
            scan = scan_from_cloud(cloud.message, sensor_origin=origin).scan
            work = ScanWork(scan, extract_features(scan, config))
        except (InputError, TransformUnavailableError) as error:
            raise type(error)(f"{side}: {error}") from error
        self._cache[key] = work
        while len(self._cache) > _CACHED_SCANS:
            self._cache.popitem(last=False)
        return work


def warm_up(config: Config) -> None:
    """Register a small made-up scene, so that everything is imported and compiled before the first real pair."""
    v = config.preprocess.voxel_size_m
    rng = np.random.default_rng(0)
    across = rng.uniform(-1, 1, (6000, 3)) * 40 * v
    across[:3000, 2] = -8 * v + np.sin(across[:3000, 0] / (5 * v)) * np.cos(across[:3000, 1] / (7 * v)) * 3 * v
    across[3000:, 0] = 30 * v + np.sin(across[3000:, 1] / (4 * v)) * 3 * v
    scan = Scan(across)
    register_pair(scan, scan, config)


def _fingerprint(message: Any) -> bytes:
    """A name for what the cloud says, whatever its stamp: equal clouds have equal features."""
    layout = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    shape = (message.height, message.width, message.point_step, message.row_step, bool(message.is_bigendian))
    digest = hashlib.blake2b(repr((message.header.frame_id, layout, shape)).encode(), digest_size=16)
    digest.update(memoryview(message.data).cast("B"))
    return digest.digest()
