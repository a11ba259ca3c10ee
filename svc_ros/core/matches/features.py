"""Fast point feature histograms (FPFH), one a point, of unit length (method section 5)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.core.kernels import fpfh as fpfh_kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import Features, PreparedScan
from svc_ros.core.scans.neighbours import RadiusGrid


def compute_features(prepared: PreparedScan, config: Config) -> Features:
    """Describe every prepared point by its FPFH (K, 33), L2-normalised; a point without neighbours gets zeros.

    As Open3D's, in a fifth of its time: the same neighbours (the nearest `max_neighbours` within the radius, the point
    itself counted), pair features and weights; float32 after the differences of points.
    """
    num, bins = len(prepared), 3 * fpfh_kernels.BINS
    radius, most = config.feature_radius_m, config.features.max_neighbours - 1
    grid = RadiusGrid.build(prepared.points, radius)
    tables = (grid.shape, grid.points, grid.column_low, grid.column_first, grid.starts)
    normals = prepared.normals[grid.order].astype(np.float32)
    histograms, descriptors = np.empty((num, bins), np.float32), np.empty((num, bins), np.float32)

    def describe_alone(part: slice) -> tuple[NDArray[Any], ...]:
        lists: tuple[NDArray[Any], ...] = fpfh_kernels.fill_own_histograms(
            part.start, part.stop, radius, most, tables, normals, histograms
        )
        return lists

    def mix(part: slice, lists: tuple[NDArray[Any], ...]) -> None:
        ends, near, weights = lists
        fpfh_kernels.mix_histograms(part.start, ends, near, weights, histograms, grid.order, descriptors)

    parts = in_parts(num)
    neighbours = on_all_processors(describe_alone, parts)
    on_all_processors(lambda k: mix(parts[k], neighbours[k]), range(len(parts)))
    return Features(prepared, descriptors)
