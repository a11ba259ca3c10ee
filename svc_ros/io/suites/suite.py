"""What the benchmarks of the field have in common: pairs in groups, and more than one definition of recall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.core.se3 import invert, nearest_pose
from svc_ros.io.datasets import Dataset, Pair, SuccessThresholds

KITTI_COLUMNS = "x y z intensity"  # of .bin files; the name .pcd.bin tells its own


@dataclass(frozen=True)
class Criterion:
    """One definition of a right pose, and of the pairs that count.

    Either rotation_deg and translation_m bound both errors, or max_rmse_m bounds the root mean square displacement
    of the reference's correspondences. Pairs whose indices differ by less than `min_gap` do not count.
    """

    name: str
    rotation_deg: float | None = None
    translation_m: float | None = None
    max_rmse_m: float | None = None
    min_gap: int = 0

    @classmethod
    def within(cls, rotation_deg: float, translation_m: float) -> Criterion:
        """Both errors within these bounds [deg], [m], named after them."""
        name = f"{rotation_deg:g} deg, {translation_m:g} m"
        return cls(name, rotation_deg=rotation_deg, translation_m=translation_m)


@dataclass(frozen=True, eq=False)
class SuitePair(Pair):
    """A pair of a benchmark. group: its scene, sequence or range; indices: of target and source in their recording;
    information: (6, 6) of the reference, order x y z [m] then the quaternion's x y z, where the benchmark has it."""

    group: str = ""
    indices: tuple[int, int] = (0, 0)
    information: Array | None = None


@dataclass(frozen=True, eq=False)
class Suite(Dataset):
    """A benchmark. criteria: its definitions of recall, of which the first is the data set's `success`; refined: folder
    of reference poses that ICP refines, one .npy a pair by name, made on first use; None: references are final."""

    criteria: tuple[Criterion, ...] = ()
    refined: Path | None = None


def pose_from_drive(T_world_source: Array, T_world_target: Array) -> Array:
    """T_target_source (4, 4) [m] of two scans of a drive, by their poses (4, 4) in the world."""
    return nearest_pose(invert(T_world_target) @ T_world_source)


def pair_of_drive(root: Path, scans: tuple[Path, Path], world: tuple[Array, Array], **told: Any) -> SuitePair:
    """A pair of a drive, source first: files below the root, poses (4, 4) [m] in the world; told: its other fields."""
    (source, target), (T_world_source, T_world_target) = scans, world
    return SuitePair(
        source=str(source.relative_to(root)),
        target=str(target.relative_to(root)),
        T_target_source=pose_from_drive(T_world_source, T_world_target),
        distance_m=float(np.linalg.norm(T_world_source[:3, 3] - T_world_target[:3, 3])),
        **told,
    )


def success_of(criteria: Sequence[Criterion]) -> SuccessThresholds:
    """The data set's `success`: the first of its criteria, which bounds a rotation and a translation."""
    rotation_deg, translation_m = criteria[0].rotation_deg, criteria[0].translation_m
    assert rotation_deg is not None
    assert translation_m is not None
    return SuccessThresholds(rotation_deg, translation_m)


def suite_of_drives(
    root: Path, name: str, sensor: str, pairs: Sequence[SuitePair], criteria: tuple[Criterion, ...]
) -> Suite:
    """A benchmark of a LiDAR on a car: returns of 3 to 80 m, seen from the scans' own origin; references are final."""
    return Suite(
        root=root,
        name=name,
        sensor=sensor,
        preset="lidar_outdoor",
        min_range_m=3.0,
        max_range_m=80.0,
        sensor_origin=np.zeros(3),
        success=success_of(criteria),
        pairs=list(pairs),
        criteria=criteria,
        columns="" if any(pair.source.lower().endswith(".pcd.bin") for pair in pairs) else KITTI_COLUMNS,
    )
