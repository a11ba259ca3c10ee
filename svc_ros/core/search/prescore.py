"""A cheap look at very many poses: how much of the source falls on agreeing surface of the target.

Inlier counts over a few hundred correspondences cannot tell a right pose with ten inliers from a wrong one with
eleven; the scans themselves can, with a few hundred points of one of them.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.kernels import prescore as prescore_kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import Array, IndexArray, PreparedScan
from svc_ros.core.scans.neighbours import nearest_grid

_MIN_COSINE = 0.6
_POSES = 32  # that one thread takes at once


def prescore(
    T: Array, source: PreparedScan, target: PreparedScan, radius_m: float, num_points: int
) -> NDArray[np.float64]:
    """Share (H,) of about `num_points` source points that each pose (H, 4, 4) puts on agreeing target surface.

    That is no farther from them than the radius, and faces roughly the same way.
    """
    sample, tables = thin_evenly(len(source), num_points), nearest_grid(target, radius_m).tables
    T, points, normals = np.ascontiguousarray(T), source.points[sample], source.normals[sample]
    agreeing = np.zeros(len(T), np.int64)

    def count(part: slice) -> None:
        prescore_kernels.count_agreeing(
            T[part], points, normals, radius_m, tables, target.normals, _MIN_COSINE, agreeing[part]
        )  # fmt: skip

    on_all_processors(count, in_parts(len(T), _POSES))
    return agreeing / max(len(sample), 1)


def thin_evenly(num: int, wanted: int) -> IndexArray:
    """About `wanted` of `num` indices, evenly spread over the (spatially sorted) points of a prepared scan."""
    return np.arange(0, num, max(1, num // max(wanted, 1)), dtype=np.int64)


def thinned_scan(scan: PreparedScan, num_points: int) -> PreparedScan:
    """The scan with about `num_points` of its points, each standing for a larger voxel; built on first use."""
    key = ("thinned_scan", num_points)
    if key not in scan.memo:
        chosen = thin_evenly(len(scan), num_points)
        voxel_size_m = scan.voxel_size_m * float(np.sqrt(len(scan) / max(len(chosen), 1)))
        scan.memo[key] = dataclasses.replace(
            scan, points=scan.points[chosen], normals=scan.normals[chosen], voxel_size_m=voxel_size_m, memo={}
        )
    thinned: PreparedScan = scan.memo[key]
    return thinned
