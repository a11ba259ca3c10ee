"""What the benchmarks of the field have in common: pairs in groups, and more than one definition of recall."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from svc_ros.core.scan import Array
from svc_ros.io.datasets import Dataset, Pair


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


@dataclass(frozen=True, eq=False)
class SuitePair(Pair):
    """A pair of a benchmark. group: its scene or sequence; indices: of target and source in the group;
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
