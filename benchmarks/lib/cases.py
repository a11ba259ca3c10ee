"""Real scans with as many points as one likes, and correspondences between them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lib.common import Dataset, config_of
from svc_ros.core import se3
from svc_ros.core.config import Config, with_values
from svc_ros.core.matches.features import compute_features
from svc_ros.core.matches.matching import match
from svc_ros.core.scan import Array, Correspondences, IndexArray, PreparedScan, Scan
from svc_ros.core.scans.preprocess import crop_range, preprocess, thin_on_voxel_grid

SETS = ("hdl64_kitti_a", "os1_64_seosan")
_BISECTIONS = 12


@dataclass(frozen=True, eq=False)
class Case:
    """Two raw scans, where the source really is (4, 4), and the configuration that fits them."""

    name: str
    source: Scan
    target: Scan
    T_target_source: Array
    config: Config

    @property
    def wrong_pose(self) -> Array:
        """A pose that is far from the right one and still lets the scans meet."""
        c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
        return self.T_target_source @ se3.make_pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], (3.0, -2.0, 0.0))


@dataclass(frozen=True, eq=False)
class SizedPair:
    """The scans of a case, thinned to the same number of points; configuration with the target's voxel size."""

    source: PreparedScan
    target: PreparedScan
    config: Config


def choose_sets(datasets: Sequence[Dataset]) -> list[Dataset]:
    """The sets of spinning sensors on cars; all sets where those are not there."""
    return [d for d in datasets if d.name in SETS] or list(datasets)


def read_case(dataset: Dataset) -> Case:
    """The pair in the middle of a set's overlaps."""
    pair = sorted(dataset.pairs, key=lambda p: p.overlap or 0.0)[len(dataset.pairs) // 2]
    assert pair.T_target_source is not None
    scans = (dataset.read_scan(path) for path in (pair.source, pair.target))
    return Case(dataset.name, *scans, pair.T_target_source, config_of(dataset))


def thin_pair(case: Case, num: int) -> SizedPair:
    """Both scans with `num` points each."""
    source, target = (thin_to(scan, num, case.config) for scan in (case.source, case.target))
    return SizedPair(source, target, with_voxel_size(case.config, target.voxel_size_m))


def thin_to(scan: Scan, num: int, config: Config) -> PreparedScan:
    """The scan on the coarsest voxel grid that leaves `num` points, and of those exactly that many.

    Radii that are set in voxels grow with the grid; tolerances in metres stay. ValueError for a scan with too few.
    """
    cropped = crop_range(scan.points, scan.sensor_origin, config.preprocess)
    low, high = 0.1 * config.preprocess.voxel_size_m, 50.0 * config.preprocess.voxel_size_m
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if len(thin_on_voxel_grid(cropped, middle)) >= num else (low, middle)
    prepared = preprocess(scan, with_voxel_size(config, low).preprocess)
    if len(prepared) < num:
        raise ValueError(f"expected a scan with at least {num} points, found {len(prepared)}")
    chosen = spread_indices(len(prepared), num)
    return dataclasses.replace(prepared, points=prepared.points[chosen], normals=prepared.normals[chosen], memo={})


def with_voxel_size(config: Config, voxel_size_m: float) -> Config:
    """The configuration on another voxel grid."""
    return with_values(config, {"preprocess.voxel_size_m": voxel_size_m, "preprocess.min_points": 3})


def forget(scan: PreparedScan) -> PreparedScan:
    """The scan without the search structures that were built for it."""
    return dataclasses.replace(scan, memo={})


def correspond(case: Case, num: int) -> Correspondences:
    """The best `num` one-way matches of a case: real ones, most of them wrong. ValueError where there are fewer."""
    changes = {"matching.strategy": "one_way", "matching.max_correspondences": num}
    config = with_values(case.config, changes)
    source, target = (
        compute_features(preprocess(s, config.preprocess), config) for s in (case.source, case.target)
    )
    found = match(source, target, config.matching)
    if len(found) < num:
        raise ValueError(f"expected {num} matches, found {len(found)}")
    return found


def choose_evenly(correspondences: Correspondences, num: int) -> Correspondences:
    """`num` of the correspondences, evenly chosen."""
    c, chosen = correspondences, spread_indices(len(correspondences), num)
    return Correspondences(c.source_points[chosen], c.target_points[chosen], c.distance[chosen])


def spread_indices(num: int, wanted: int) -> IndexArray:
    """`wanted` of `num` indices, evenly spread, both ends among them."""
    return np.linspace(0, num - 1, wanted).round().astype(np.int64)
