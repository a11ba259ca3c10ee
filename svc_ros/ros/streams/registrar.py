"""Mode `pair`: a pair of clouds becomes a decision; what was computed of a cloud is kept. No rclpy here."""

from __future__ import annotations

import functools
import hashlib
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.registration import extract_features, prepare, verify
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features, Scan
from svc_ros.io.results import result_to_json
from svc_ros.pipeline.decide import refused, register_pair
from svc_ros.pipeline.place import look_at_place
from svc_ros.pipeline.place_search import most_alike
from svc_ros.ros.streams.decision import CloudReader, Decision, Look, drop_decision, labels, named_side, received_s
from svc_ros.ros.streams.worker import Cloud, DropJob, Job, PairJob, ScanJob

_CACHED_SCANS = 3  # both of the last pair, and one that is on its way


@dataclass(frozen=True, eq=False)
class ScanWork:
    """What was computed of one cloud."""

    scan: Scan
    features: Features


@dataclass(frozen=True, eq=False)
class _LastPair:
    """The last pair that was registered, to be judged again."""

    job: PairJob
    works: tuple[ScanWork, ScanWork]
    T_target_source: Array | None


class PairRegistrar:
    """Turns pairs into decisions, and reuses the features of a cloud that comes again.

    origin_of: where the sensor stood in the frame of a cloud, (frame, stamp_ns) -> (3,) [m]; guess_of: a pose
    (4, 4) to try first for a source stamp, or None. Belongs to one thread.
    """

    def __init__(
        self, origin_of: Callable[[str, int], Array], guess_of: Callable[[int], Array | None] = lambda _stamp: None
    ) -> None:
        self._reader, self._guess_of = CloudReader(origin_of), guess_of
        self._cache: OrderedDict[tuple[Any, ...], ScanWork] = OrderedDict()
        self._last: _LastPair | None = None
        self.num_reused = 0

    def process(self, job: Job, config: Config) -> list[Decision]:
        """The one decision on one job; never raises."""
        return [self.decide(job, config)]

    def decide(self, job: Job, config: Config) -> Decision:
        """The decision on one job; never raises."""
        if isinstance(job, DropJob):
            return drop_decision(job, config)
        start, came = time.monotonic(), received_s(job)
        assert came is not None
        assert not isinstance(job, ScanJob)
        timings = {"queue_ms": 1e3 * (start - came)}
        look = None
        try:
            works = self._work("source", job.source, config), self._work("target", job.target, config)
            timings["features_ms"] = 1e3 * (time.monotonic() - start)
            result = self._register(works[0].features, works[1].features, job.source.stamp_ns, config)
            self._last = _LastPair(job, works, result.best_candidate)
            look = _look(works, result.best_candidate, str(job.target.message.header.frame_id))
        except Exception as error:
            result = refused(error, config)
        timings["latency_ms"] = 1e3 * (time.monotonic() - came)
        return Decision(result, *labels(job), timings, look)

    def judge_again(self, config: Config) -> dict[str, Any]:
        """Judge the last pair's guess, or its own pose where there is no guess; see Engine."""
        if self._last is None:
            raise InputError("expected a pair that was registered, found none since the start or the last reset")
        job, works = self._last.job, self._last.works
        T = self._guess_of(job.source.stamp_ns)
        origin, T = ("registration", self._last.T_target_source) if T is None else ("guess", T)
        if T is None:
            raise InputError("expected a pose to verify, found none: the last pair has neither a guess nor a candidate")
        result = verify(works[0].features, works[1].features, T, config)
        return result_to_json(
            result, source_stamp_ns=job.source.stamp_ns, target_stamp_ns=job.target.stamp_ns, origin=origin
        )

    def reset(self) -> None:
        """Drop the cached features and the last pair."""
        self._cache.clear()
        self._last = None

    def warm_up(self, config: Config) -> None:
        """See `warm_up`."""
        warm_up(config)

    def numbers(self) -> dict[str, Any]:
        """How often features were reused."""
        return {"features_reused": self.num_reused}

    def _register(self, source: Features, target: Features, stamp_ns: int, config: Config) -> RegistrationResult:
        guess = self._guess_of(stamp_ns)
        if guess is not None:
            verified = verify(source, target, guess, config)
            if verified.accepted:
                return verified
        return register_pair(source, target, config)

    def _work(self, side: str, cloud: Cloud, config: Config) -> ScanWork:
        try:
            origin = self._reader.origin(cloud)
            key = (_fingerprint(cloud.message), tuple(origin.tolist()), config)
            if key in self._cache:
                self.num_reused += 1
                self._cache.move_to_end(key)
                return self._cache[key]
            scan = self._reader.scan(cloud, origin)
            work = ScanWork(scan, extract_features(scan, config))
        except (InputError, TransformUnavailableError) as error:
            raise named_side(side, error) from error
        self._cache[key] = work
        while len(self._cache) > _CACHED_SCANS:
            self._cache.popitem(last=False)
        return work


def _look(works: tuple[ScanWork, ScanWork], T_target_source: Array | None, frame_id: str) -> Look | None:
    if T_target_source is None:
        return None
    source, target = works
    return Look(
        source.scan.points, source.features.prepared, target.features.prepared, T_target_source, np.eye(4), frame_id
    )


@functools.lru_cache(maxsize=8)
def warm_up(config: Config) -> None:
    """Register two small made-up scenes, so that everything is imported and compiled before the first real pair.

    Each with itself is soon accepted; one with the other is looked at as long as any pair. A process that has done it
    for this configuration is warm, and has nothing to do.
    """
    scan = made_up_scan(config)
    register_pair(scan, scan, config)
    register_pair(made_up_scan(config, seed=1), scan, config)
    look = look_at_place(prepare(scan, config))
    most_alike(look, [look], 1)


def made_up_scan(config: Config, seed: int = 0) -> Scan:
    """A floor with bumps and a wall, large enough for the voxels of `config`; other seeds have it elsewhere."""
    v = config.preprocess.voxel_size_m
    rng = np.random.default_rng(seed)
    floor, wall = across = rng.uniform(-1, 1, (2, 1250, 3)) * 40 * v
    floor[:, 2] = -8 * v + np.sin(floor[:, 0] / (5 * v)) * np.cos(floor[:, 1] / (7 * v)) * 3 * v
    wall[:, 0] = (30 - 18 * seed) * v + np.sin(wall[:, 1] / ((4 + 3 * seed) * v)) * 3 * v
    return Scan(across.reshape(-1, 3))


def _fingerprint(message: Any) -> bytes:
    """A name for what the cloud says, whatever its stamp: equal clouds have equal features."""
    layout = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    shape = (message.height, message.width, message.point_step, message.row_step, bool(message.is_bigendian))
    digest = hashlib.blake2b(repr((message.header.frame_id, layout, shape)).encode(), digest_size=16)
    digest.update(memoryview(message.data).cast("B"))
    return digest.digest()
