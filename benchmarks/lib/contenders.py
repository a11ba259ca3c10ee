"""A pair of raw scans by every method, from raw points to an answer. Each method imports its packages itself."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lib.common import Dataset, config_of
from svc_ros.core.config import Config
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Features, Scan
from svc_ros.io.datasets import Pair

KISS_VOXEL_M = 0.3  # its own default, recommended for outdoor scans; its other settings are its defaults too
Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Answer:
    """Whether a method stands by its answer, and its pose (4, 4) if it has one."""

    accepted: bool
    T_target_source: Pose | None


@dataclass(frozen=True, eq=False)
class RawPair:
    """Two raw scans, cut to the range limits of their set: what every method gets."""

    dataset: Dataset
    pair: Pair
    source: Scan
    target: Scan
    config: Config

    @classmethod
    def read(cls, dataset: Dataset, pair: Pair) -> RawPair:
        """Read both scans of a pair."""
        scans = (_within_range(dataset.read_scan(path), dataset) for path in (pair.source, pair.target))
        return cls(dataset, pair, *scans, config_of(dataset))


Call = Callable[[], Answer]


def register(raw: RawPair) -> Call:
    """svc_ros from raw points to the verdict."""
    from svc_ros.core.registration import register as run

    return lambda: _answer(run(raw.source, raw.target, raw.config))


def register_reused(raw: RawPair) -> Call:
    """svc_ros, the source from raw points; the target's features were computed for an earlier pair."""
    from svc_ros.core.registration import extract_features
    from svc_ros.core.registration import register as run

    target = extract_features(raw.target, raw.config)
    return lambda: _answer(run(raw.source, target, raw.config))


def verify(raw: RawPair) -> Call:
    """svc_ros judges the reference pose; both scans are prepared and were used before."""
    from svc_ros.core.registration import prepare
    from svc_ros.core.registration import verify as run

    source, target = (prepare(scan, raw.config) for scan in (raw.source, raw.target))
    return lambda: _answer(run(source, target, raw.pair.T_target_source, raw.config))


def verify_first(raw: RawPair) -> Call:
    """svc_ros judges the reference pose; both scans are prepared, but were never looked at before."""
    from svc_ros.core.registration import prepare
    from svc_ros.core.registration import verify as run

    source, target = (prepare(scan, raw.config) for scan in (raw.source, raw.target))

    def call() -> Answer:
        fresh = (dataclasses.replace(scan, memo={}) for scan in (source, target))
        return _answer(run(*fresh, raw.pair.T_target_source, raw.config))

    return call


def kiss_matcher(raw: RawPair) -> Call:
    """KISS-Matcher from raw points with its default settings."""
    import kiss_matcher as package

    clouds = [scan.points.astype(np.float32) for scan in (raw.source, raw.target)]

    def call() -> Answer:
        solution = package.KISSMatcher(package.KISSMatcherConfig(KISS_VOXEL_M)).estimate(*clouds)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = solution.rotation, np.ravel(solution.translation)
        return Answer(bool(solution.valid), T)

    return call


def open3d_ransac(raw: RawPair) -> Call:
    """Open3D's RANSAC on the voxel grid and the FPFH that svc_ros takes; all of it counts."""
    import open3d as o3d

    from lib.peers import TUTORIAL_ITERATIONS, ransac
    from svc_ros.core.registration import extract_features

    def call() -> Answer:
        (source, fpfh_s), (target, fpfh_t) = (
            _for_open3d(extract_features(scan, raw.config)) for scan in (raw.source, raw.target)
        )
        matches = o3d.pipelines.registration.correspondences_from_features(fpfh_s, fpfh_t, mutual_filter=True)
        voxel = raw.config.preprocess.voxel_size_m
        return Answer(True, ransac(source, target, matches, voxel, TUTORIAL_ITERATIONS))

    return call


CONTENDERS: dict[str, Callable[[RawPair], Call]] = {  # ours side by side: their times are set in relation
    "register": register,
    "register_reused": register_reused,
    "verify": verify,
    "verify_first": verify_first,
    "kiss_matcher": kiss_matcher,
    "open3d_ransac": open3d_ransac,
}
PACKAGES = {"kiss_matcher": "kiss_matcher", "open3d_ransac": "open3d"}


def missing(names: tuple[str, ...] = tuple(CONTENDERS)) -> Iterator[tuple[str, str]]:
    """Methods that cannot run here, and why."""
    import importlib

    for name in names:
        try:
            importlib.import_module(PACKAGES.get(name, "svc_ros"))
        except ImportError as error:
            yield name, f"{error}; see the extra `compare`"


def _answer(result: RegistrationResult) -> Answer:
    return Answer(result.accepted, result.best_candidate)


def _for_open3d(features: Features) -> tuple[Any, Any]:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(features.keypoints)))
    descriptors = o3d.pipelines.registration.Feature()
    descriptors.data = features.descriptors.T.astype(np.float64)
    return cloud, descriptors


def _within_range(scan: Scan, dataset: Dataset) -> Scan:
    points = scan.points
    distance: Any = np.linalg.norm(points - scan.sensor_origin, axis=1)
    return dataclasses.replace(
        scan, points=points[(distance >= dataset.min_range_m) & (distance <= dataset.max_range_m)], point_times_s=None
    )
