"""A cheap look at very many poses: how much of the source falls on agreeing surface of the target.

Inlier counts over a few hundred correspondences cannot tell a right pose with ten inliers from a wrong one with
eleven; the scans themselves can. One hash look-up a point makes a pose cost microseconds.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import prescore_kernels
from svc_ros.core.scan import Array, IndexArray, PreparedScan

_MIN_COSINE = 0.6


@dataclass(frozen=True, eq=False)
class DilatedCells:
    """Cells that hold surface or stand beside it, each with the mean normal of the surface around it.

    normals: (C, 3), not normalised to one where the surface bends; table_*: hash from packed cell to row.
    """

    normals: Array
    table_keys: IndexArray
    table_row: IndexArray
    edge_m: float

    @classmethod
    def build(cls, scan: PreparedScan, edge_m: float) -> DilatedCells:
        """Mark every cell of `edge_m` within one cell of a point."""
        keys = np.empty(len(scan), np.int64)
        prescore_kernels.fill_keys(scan.points, 1.0 / edge_m, keys)
        cells, sums, *_ = _sum_by_key(keys, scan.normals)
        steps = np.array([(a << 42) + (b << 21) + c for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)])
        _, sums, table_keys, table_row = _sum_by_key(
            (cells[:, None] + steps).ravel(), np.repeat(sums, len(steps), axis=0)
        )
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
        return cls(sums, table_keys, table_row, edge_m)


def _sum_by_key(keys: IndexArray, values: Array) -> tuple[IndexArray, Array, IndexArray, IndexArray]:
    """Distinct keys and the sums (_, 3) of their values, with the hash table from key to row."""
    capacity = 1 << int(2 * len(keys) - 1).bit_length()
    table_keys, table_row, found = np.empty(capacity, np.int64), np.empty(capacity, np.int64), np.empty_like(keys)
    sums = np.empty((len(keys), 3))
    num = prescore_kernels.sum_by_key(keys, values, table_keys, table_row, found, sums)
    return found[:num], sums[:num], table_keys, table_row


def dilated_cells(scan: PreparedScan, edge_m: float) -> DilatedCells:
    """The scan's own DilatedCells of that edge, built on first use."""
    key = ("dilated_cells", edge_m)
    if key not in scan.memo:
        scan.memo[key] = DilatedCells.build(scan, edge_m)
    cells: DilatedCells = scan.memo[key]
    return cells


def prescore(
    T: Array, source: PreparedScan, target: PreparedScan, edge_m: float, num_points: int
) -> NDArray[np.float64]:
    """Share (H,) of about `num_points` source points that each pose (H, 4, 4) puts on agreeing target surface."""
    cells = dilated_cells(target, edge_m)
    sample = thin_evenly(len(source), num_points)
    agreeing = np.zeros(len(T), np.int64)
    prescore_kernels.count_agreeing(
        np.ascontiguousarray(T), source.points[sample], source.normals[sample],
        cells.table_keys, cells.table_row, cells.normals, edge_m, _MIN_COSINE, agreeing,
    )  # fmt: skip
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
