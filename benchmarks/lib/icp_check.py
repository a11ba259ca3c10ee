"""Our point-to-plane ICP beside small_gicp's: the same pose first, then the times of both in turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lib.cases import Case
from lib.checks import OURS, DisagreementError
from lib.timing import medians, time_in_turns
from svc_ros.core import se3
from svc_ros.core.scan import Array
from svc_ros.core.scans.preprocess import preprocess
from svc_ros.core.search.icp import index, refine_by_icp
from svc_ros.core.search.prescore import thin_evenly

SMALL_GICP = "small_gicp"
Job = Callable[[], Array]
_SAME_DEG, _SAME_M = 0.3, 0.1  # its normals are of ten neighbours
_START = se3.make_pose(np.eye(3), (0.2, -0.1, 0.05))


def compare_icp(cases: Sequence[Case], rounds: int) -> dict[str, Any]:
    """The last refinement of a pose, on scans that were indexed before, from 0.2 m beside the reference."""
    times: dict[str, list[float]] = {OURS: [], SMALL_GICP: []}
    for case in cases:
        jobs = {OURS: _ours(case), SMALL_GICP: _theirs(case)}
        angle, distance = se3.pose_error(jobs[OURS](), jobs[SMALL_GICP]())
        if angle > _SAME_DEG or distance > _SAME_M:
            raise DisagreementError(f"{case.name}: the poses of ICP differ by {angle:.2f} deg and {distance:.3f} m")
        for name, time_ms in medians(time_in_turns(jobs, rounds)).items():
            times[name].append(time_ms)
    return {
        "speedup_vs_small_gicp": sum(times[SMALL_GICP]) / sum(times[OURS]),
        "time_ms": float(np.mean(times[OURS])),
        "small_gicp_time_ms": float(np.mean(times[SMALL_GICP])),
    }


def _ours(case: Case) -> Job:
    source, target = (preprocess(scan, case.config.preprocess) for scan in (case.source, case.target))
    index(target, case.config)
    return lambda: refine_by_icp(
        case.T_target_source @ _START, source, target, case.config, case.config.shortlist.icp_last_points
    )


def _theirs(case: Case) -> Job:
    import small_gicp

    limits = case.config.shortlist
    source, target = (preprocess(scan, case.config.preprocess).points for scan in (case.source, case.target))
    tree, cloud = small_gicp.KdTree(target), small_gicp.PointCloud(target)
    small_gicp.estimate_normals(cloud, tree, num_neighbors=10)
    few, many = (
        small_gicp.PointCloud(source[thin_evenly(len(source), num)])
        for num in (min(limits.icp_points, limits.icp_last_points), limits.icp_last_points)
    )

    def job() -> Array:
        T = case.T_target_source @ _START
        for points, distance_m in ((few, limits.icp_distance_m), (many, 0.5 * limits.icp_distance_m)):
            T = small_gicp.align(
                cloud, points, tree, T, registration_type="PLANE_ICP", max_correspondence_distance=distance_m,
                max_iterations=limits.icp_rounds, rotation_epsilon=1e-4, translation_epsilon=5e-4,
            ).T_target_source  # fmt: skip
        return np.asarray(T)

    return job
