"""Spatial compatibility of correspondences: first order as sparse rows, both thresholds as bit sets.

delta_ij = | |x_i - x_j| - |y_i - y_j| |. Nothing dense of N x N floats is built (method section 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.kernels import compatibility as kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import Array, Correspondences, IndexArray

_ROWS = 256  # that one thread takes at once


@dataclass(frozen=True, eq=False)
class Compatibility:
    """First-order matrix A of N correspondences and its two bit sets.

    starts (N + 1,), columns (E,), values (E,): A without its diagonal (of ones), row by row;
    loose, tight: (N, ceil(N / 64)) uint64, bit j of row i: delta_ij < d_thr and < d_thr / 2 (H and G).
    """

    starts: IndexArray
    columns: NDArray[np.int32]
    values: NDArray[np.float32]
    loose: NDArray[np.uint64]
    tight: NDArray[np.uint64]


def compute_compatibility(correspondences: Correspondences, threshold_m: float) -> Compatibility:
    """Compare all pairs of correspondences; `threshold_m` is d_thr."""
    num = len(correspondences)
    x, y = (np.ascontiguousarray(p.T) for p in (correspondences.source_points, correspondences.target_points))
    loose, tight = (np.zeros((num, (num + 63) // 64), np.uint64) for _ in range(2))
    counts = np.zeros(num, np.int64)
    rows = in_parts(num, _ROWS)
    on_all_processors(
        lambda part: kernels.mark_compatible(part.start, part.stop, x, y, threshold_m, loose, tight, counts), rows
    )
    starts = np.concatenate(([0], np.cumsum(counts)))
    columns, values = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.float32)
    on_all_processors(
        lambda part: kernels.fill_compatible(
            part.start, part.stop, x, y, threshold_m, loose, starts, columns, values
        ), rows
    )  # fmt: skip
    return Compatibility(starts, columns, values, loose, tight)


def leading_eigenvector(compatibility: Compatibility, rounds: int) -> Array:
    """Confidence (N,) of each correspondence: leading eigenvector of A by power iteration."""
    vector = np.ones(len(compatibility.starts) - 1)
    c = compatibility
    kernels.leading_eigenvector(c.starts, c.columns, c.values, rounds, vector)
    return vector
