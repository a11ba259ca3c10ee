"""One pair by one method: svc_ros in its variants, and other packages on the same thinned points."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import _common  # noqa: F401  it finds the checkout
import numpy as np
from _cliques import generate_clique_hypotheses

from svc_ros.core import registration, shortlist
from svc_ros.core.config import Config, with_values
from svc_ros.core.scan import Array, Features
from svc_ros.pipeline.decide import register_pair


@dataclass(frozen=True)
class Attempt:
    """The answer of a method: whether it stands by it, its pose (4, 4) if any, the time [ms] without descriptors."""

    accepted: bool
    T_target_source: Array | None
    time_ms: float


Method = Callable[[Features, Features, Config], Attempt]

CHANGES: dict[str, Mapping[str, Any]] = {
    "svc": {},
    "svc_paper": {"method": "svc_paper"},
    "sc2": {"method": "sc2"},
    "svc, one-way matches": {"matching.strategy": "one_way"},
    "svc, shortlist by rank": {},
    "svc, no wide search": {"shortlist.rough_poses": 0},
    "svc, a fifth of the seeds": {"hypotheses.seed_ratio": 0.2},
    "svc, three-point cliques": {},
    "svc, gravity within 10 deg": {"hypotheses.gravity_aligned": True, "hypotheses.max_tilt_deg": 10.0},
    "svc, FPFH 5 voxels, normals 2": {
        "features.radius_voxels": 5.0, "features.max_neighbours": 100,
        "preprocess.normal_radius_voxels": 2.0, "preprocess.normal_max_neighbours": 30,
    },
}  # fmt: skip


def run_svc_ros(source: Features, target: Features, config: Config) -> Attempt:
    """register() with that configuration; descriptors are given."""
    result = register_pair(source, target, config)
    return Attempt(result.accepted, result.best_candidate, result.time_ms.get("total", 0.0))


def run_without_prescore(source: Features, target: Features, config: Config) -> Attempt:
    """register() with a shortlist that knows the hypotheses' rank only."""
    with patch.object(shortlist, "prescore", lambda T, *_: np.zeros(len(T))):
        return run_svc_ros(source, target, config)


def run_with_cliques(source: Features, target: Features, config: Config) -> Attempt:
    """register() with hypotheses from three correspondences each instead of SC2-PCR's sets."""
    with patch.object(registration, "generate_hypotheses", generate_clique_hypotheses):
        return run_svc_ros(source, target, config)


def run_open3d_ransac(source: Features, target: Features, config: Config) -> Attempt:
    """Open3D's RANSAC on mutual FPFH matches, confidence 0.999, the settings of its tutorial."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    distance = 1.5 * config.preprocess.voxel_size_m
    clouds = _open3d_input(source), _open3d_input(target)
    o3d.utility.random.seed(0)
    start = time.perf_counter()
    result = registration.registration_ransac_based_on_feature_matching(
        clouds[0][0], clouds[1][0], clouds[0][1], clouds[1][1], True, distance,
        registration.TransformationEstimationPointToPoint(False), 3,
        [registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
         registration.CorrespondenceCheckerBasedOnDistance(distance)],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    return _attempt(result.transformation, start)


def run_open3d_fgr(source: Features, target: Features, config: Config) -> Attempt:
    """Open3D's fast global registration, the settings of its tutorial."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    clouds = _open3d_input(source), _open3d_input(target)
    o3d.utility.random.seed(0)
    option = registration.FastGlobalRegistrationOption(
        maximum_correspondence_distance=0.5 * config.preprocess.voxel_size_m
    )
    start = time.perf_counter()
    result = registration.registration_fgr_based_on_feature_matching(
        clouds[0][0], clouds[1][0], clouds[0][1], clouds[1][1], option
    )
    return _attempt(result.transformation, start)


def run_kiss_matcher(source: Features, target: Features, config: Config) -> Attempt:
    """KISS-Matcher with its defaults for the voxel size; its own descriptors are left out of the time as all others."""
    import kiss_matcher

    settings = kiss_matcher.KISSMatcherConfig(config.preprocess.voxel_size_m, use_voxel_sampling=False)
    matcher = kiss_matcher.KISSMatcher(settings)
    a, b = (f.prepared.points.astype(np.float32) for f in (source, target))
    start = time.perf_counter()
    solution = matcher.estimate(a, b)
    total = time.perf_counter() - start
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = solution.rotation, np.ravel(solution.translation)
    extraction = matcher.get_processing_time() + matcher.get_extraction_time()
    return Attempt(bool(solution.valid), T, 1e3 * max(total - extraction, 0.0))


OTHERS: dict[str, Method] = {
    "Open3D RANSAC": run_open3d_ransac,
    "Open3D FGR": run_open3d_fgr,
    "KISS-Matcher": run_kiss_matcher,
}
PATCHED: dict[str, Method] = {
    "svc, shortlist by rank": run_without_prescore,
    "svc, three-point cliques": run_with_cliques,
}
METHODS = (*CHANGES, *OTHERS)


def method_of(name: str, config: Config) -> tuple[Method, Config]:
    """What runs a method, and with which configuration."""
    if name in OTHERS:
        return OTHERS[name], config
    return PATCHED.get(name, run_svc_ros), with_values(config, CHANGES[name])


def why_not(name: str) -> str | None:
    """The reason why a method cannot run here, None if it can."""
    try:
        if name == "KISS-Matcher":
            import kiss_matcher  # noqa: F401
        elif name in OTHERS:
            import open3d  # noqa: F401
    except ImportError as error:
        return f"{error}; see the extra `compare`"
    return None


def _attempt(T: Array, start: float) -> Attempt:
    return Attempt(True, np.asarray(T), 1e3 * (time.perf_counter() - start))


def _open3d_input(features: Features) -> tuple[Any, Any]:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(features.keypoints)))
    descriptors = o3d.pipelines.registration.Feature()
    descriptors.data = features.descriptors.T.astype(np.float64)
    return cloud, descriptors
