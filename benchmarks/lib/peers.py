"""Two raw scans by other packages, prepared as their users prepare them, and whether they stand by their answer.

Points within the set's range limits, on the voxel size of the set's preset. Each package has the acceptance that its
own examples, or most of its users, ask for; svc_ros has no part in it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.scan import Array, Scan

KISS_MIN_INLIERS = 5  # of its examples: fewer final inliers "might have failed"
MIN_FITNESS = 0.3  # share of the source's points with a neighbour in the target
NORMAL_RADIUS_VOXELS, NORMAL_NEIGHBOURS = 2.0, 30  # Open3D's tutorial, from here on
FEATURE_RADIUS_VOXELS, FEATURE_NEIGHBOURS = 5.0, 100
RANSAC_DISTANCE_VOXELS, RANSAC_EDGE_RATIO, RANSAC_CONFIDENCE = 1.5, 0.9, 0.999
TUTORIAL_ITERATIONS = 100_000
FGR_DISTANCE_VOXELS = 0.5
RANSAC_ITERATIONS = 1_000_000  # ten times the tutorial's: pairs of little overlap need them
_SEED = 0


@dataclass(frozen=True, eq=False)
class Attempt:
    """What a method made of a pair.

    accepted: it stands by its pose; T_target_source: (4, 4), None if it has none; time_ms: from raw points to that;
    score: what it accepts by, more is surer, None if it has no such number.
    """

    accepted: bool
    T_target_source: Array | None
    time_ms: float
    score: float | None = None


@dataclass(frozen=True, eq=False)
class Described:
    """What Open3D's methods get of a pair: both clouds on their grids, mutual FPFH matches, the time [ms] for it."""

    source: Any
    target: Any
    matches: Any
    time_ms: float


Method = Callable[[Scan, Scan, Config], Attempt]


def run_kiss_matcher(source: Scan, target: Scan, config: Config) -> Attempt:
    """KISS-Matcher with its defaults for the voxel size."""
    import kiss_matcher

    clouds = [points_within_range(scan, config).astype(np.float32) for scan in (source, target)]
    start = time.perf_counter()
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(config.preprocess.voxel_size_m))
    solution = matcher.estimate(*clouds)
    time_ms = _since(start)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = solution.rotation, np.ravel(solution.translation)
    inliers = int(matcher.get_num_final_inliers())
    return Attempt(bool(solution.valid) and inliers >= KISS_MIN_INLIERS, T, time_ms, float(inliers))


def run_open3d_ransac(source: Scan, target: Scan, config: Config) -> Attempt:
    """Open3D's RANSAC on mutual matches of its FPFH."""
    pair = describe_by_open3d(source, target, config)
    start = time.perf_counter()
    T = ransac(pair.source, pair.target, pair.matches, config.preprocess.voxel_size_m, RANSAC_ITERATIONS)
    return _judged_by_fitness(pair, T, config, start)


def run_open3d_fgr(source: Scan, target: Scan, config: Config) -> Attempt:
    """Open3D's fast global registration on the same matches."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    pair = describe_by_open3d(source, target, config)
    distance = FGR_DISTANCE_VOXELS * config.preprocess.voxel_size_m
    o3d.utility.random.seed(_SEED)
    start = time.perf_counter()
    result = registration.registration_fgr_based_on_correspondence(
        pair.source, pair.target, pair.matches,
        registration.FastGlobalRegistrationOption(maximum_correspondence_distance=distance),
    )  # fmt: skip
    return _judged_by_fitness(pair, np.array(result.transformation), config, start)


def ransac(source: Any, target: Any, matches: Any, voxel_size_m: float, max_iterations: int) -> Array:
    """The pose (4, 4) that Open3D's RANSAC finds between two clouds by matches (M, 2), as in its tutorial."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    distance = RANSAC_DISTANCE_VOXELS * voxel_size_m
    o3d.utility.random.seed(_SEED)
    result = registration.registration_ransac_based_on_correspondence(
        source, target, matches, distance, registration.TransformationEstimationPointToPoint(False), 3,
        [registration.CorrespondenceCheckerBasedOnEdgeLength(RANSAC_EDGE_RATIO),
         registration.CorrespondenceCheckerBasedOnDistance(distance)],
        registration.RANSACConvergenceCriteria(max_iterations, RANSAC_CONFIDENCE),
    )  # fmt: skip
    return np.array(result.transformation)


@lru_cache(maxsize=1)
def describe_by_open3d(source: Scan, target: Scan, config: Config) -> Described:
    """Grid, normals, FPFH and matches of a pair, once for both of Open3D's methods; each counts the whole time."""
    import open3d as o3d

    start = time.perf_counter()
    (cloud_s, fpfh_s), (cloud_t, fpfh_t) = (_open3d_features(scan, config) for scan in (source, target))
    matches = o3d.pipelines.registration.correspondences_from_features(fpfh_s, fpfh_t, mutual_filter=True)
    return Described(cloud_s, cloud_t, matches, _since(start))


def points_within_range(scan: Scan, config: Config) -> Array:
    """The raw points (N, 3) [m] within the range limits of the set."""
    distance = np.linalg.norm(scan.points - scan.sensor_origin, axis=1)
    limits = config.preprocess
    return np.array(scan.points[(distance >= limits.min_range_m) & (distance <= limits.max_range_m)])


PEERS: dict[str, Method] = {
    "KISS-Matcher": run_kiss_matcher,
    "Open3D RANSAC": run_open3d_ransac,
    "Open3D FGR": run_open3d_fgr,
}
_OPEN3D_INPUT = (
    f"raw points; Open3D's voxel grid, normals ({NORMAL_RADIUS_VOXELS:g} voxels), FPFH ({FEATURE_RADIUS_VOXELS:g} "
    "voxels), mutual matches; "
)
_OPEN3D_ACCEPTS = f"fitness of at least {MIN_FITNESS} within {RANSAC_DISTANCE_VOXELS} voxels"
PREPARED = {  # method -> what it gets
    "KISS-Matcher": "raw points; its defaults for the voxel size of the preset",
    "Open3D RANSAC": f"{_OPEN3D_INPUT}within {RANSAC_DISTANCE_VOXELS} voxels, edge lengths within "
    f"{RANSAC_EDGE_RATIO}, at most {RANSAC_ITERATIONS} iterations, confidence {RANSAC_CONFIDENCE}",
    "Open3D FGR": f"{_OPEN3D_INPUT}within {FGR_DISTANCE_VOXELS} voxels",
}
ACCEPTS = {  # method -> when it counts as accepted
    "KISS-Matcher": f"valid, and at least {KISS_MIN_INLIERS} final inliers, as in its examples",
    "Open3D RANSAC": _OPEN3D_ACCEPTS,
    "Open3D FGR": _OPEN3D_ACCEPTS,
}


def _open3d_features(scan: Scan, config: Config) -> tuple[Any, Any]:
    import open3d as o3d

    voxel, search = config.preprocess.voxel_size_m, o3d.geometry.KDTreeSearchParamHybrid
    points = o3d.utility.Vector3dVector(points_within_range(scan, config))
    cloud = o3d.geometry.PointCloud(points).voxel_down_sample(voxel)
    cloud.estimate_normals(search(NORMAL_RADIUS_VOXELS * voxel, NORMAL_NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(np.array(scan.sensor_origin))
    around = search(FEATURE_RADIUS_VOXELS * voxel, FEATURE_NEIGHBOURS)
    return cloud, o3d.pipelines.registration.compute_fpfh_feature(cloud, around)


def _judged_by_fitness(pair: Described, T: Array, config: Config, start: float) -> Attempt:
    import open3d as o3d

    distance = RANSAC_DISTANCE_VOXELS * config.preprocess.voxel_size_m
    found = o3d.pipelines.registration.evaluate_registration(pair.source, pair.target, distance, T)
    return Attempt(found.fitness >= MIN_FITNESS, T, pair.time_ms + _since(start), float(found.fitness))


def _since(start: float) -> float:
    return 1e3 * (time.perf_counter() - start)
