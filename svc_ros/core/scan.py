"""The data that flows through a registration. Frozen, checked once when built, arrays read-only."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError

if TYPE_CHECKING:  # it brings numba, which the help of the command line does without
    from svc_ros.core.range_image import RangeImage

Array = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def _zero_origin() -> Array:
    return np.zeros(3)


def _no_directions() -> Array:
    return np.zeros((0, 3))


def frozen_array(value: ArrayLike, dtype: type, name: str, shape: tuple[int | None, ...]) -> NDArray[Any]:
    """Return a read-only view (or converted copy) of `value`; None in `shape` leaves that axis free."""
    try:
        array: NDArray[Any] = np.ascontiguousarray(value, dtype)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected an array of numbers, found {value!r:.80}") from None
    if array.ndim != len(shape) or any(e is not None and e != n for e, n in zip(shape, array.shape, strict=True)):
        expected = " x ".join("N" if e is None else str(e) for e in shape)
        raise InputError(f"{name}: expected shape {expected}, found {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, found {int((~np.isfinite(array)).sum())} NaN or inf")
    view = array.view()
    view.flags.writeable = False
    return view


def _freeze(instance: object, name: str, dtype: type, shape: tuple[int | None, ...]) -> None:
    label = f"{type(instance).__name__}.{name}"
    object.__setattr__(instance, name, frozen_array(getattr(instance, name), dtype, label, shape))


def _check_unit(directions: Array, name: str) -> None:
    lengths = np.linalg.norm(directions, axis=1)
    if (np.abs(lengths - 1.0) > 1e-3).any():
        raise InputError(f"{name}: expected unit vectors, found lengths {lengths.min():g} to {lengths.max():g}")


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a range sensor, as it came from outside.

    points: (N, 3) [m] in the frame `frame_id`; sensor_origin: (3,) [m], where the sensor stood in that frame;
    stamp_ns: header stamp; point_times_s: (N,) offsets [s] from the stamp where the sensor tells them;
    free_directions: (F, 3) unit, in that frame: where the sensor tells that it looked along them and met nothing.
    """

    points: Array
    stamp_ns: int = 0
    frame_id: str = ""
    sensor_origin: Array = field(default_factory=_zero_origin)
    point_times_s: Array | None = None
    free_directions: Array | None = None

    def __post_init__(self) -> None:
        _freeze(self, "points", np.float64, (None, 3))
        _freeze(self, "sensor_origin", np.float64, (3,))
        if self.point_times_s is not None:
            _freeze(self, "point_times_s", np.float64, (len(self.points),))
        if self.free_directions is not None:
            _freeze(self, "free_directions", np.float64, (None, 3))
            _check_unit(self.free_directions, "Scan.free_directions")

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class PreparedScan:
    """A scan after range crop and voxel grid: what every later stage looks at.

    points: (K, 3) [m]; normals: (K, 3) unit, turned towards the sensor; sensor_origin: (3,) [m];
    voxel_size_m: the grid that thinned it; beam_spacing_deg: angle between neighbouring beams of the raw scan, 0 if
    unknown; free_directions: (F, 3) unit, along which the sensor met nothing, about a degree apart; range_image: of all
    raw points, how far the sensor looked, None where nobody made one; memo: search structures, built on first use and
    kept with the scan.
    """

    points: Array
    normals: Array
    sensor_origin: Array
    voxel_size_m: float
    stamp_ns: int = 0
    frame_id: str = ""
    beam_spacing_deg: float = 0.0
    free_directions: Array = field(default_factory=_no_directions)
    range_image: RangeImage | None = None
    memo: dict[Hashable, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        _freeze(self, "points", np.float64, (None, 3))
        _freeze(self, "normals", np.float64, (len(self.points), 3))
        _freeze(self, "sensor_origin", np.float64, (3,))
        _freeze(self, "free_directions", np.float64, (None, 3))

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Features:
    """A prepared scan with one descriptor a point; computed once a scan and reused in every pair.

    descriptors: (K, D), rows of unit length (FPFH: D = 33).
    """

    prepared: PreparedScan
    descriptors: NDArray[np.float32]

    def __post_init__(self) -> None:
        _freeze(self, "descriptors", np.float32, (len(self.prepared), None))

    @property
    def keypoints(self) -> Array:
        """(K, 3) [m], the points that the descriptors belong to."""
        return self.prepared.points

    @property
    def normals(self) -> Array:
        """(K, 3) unit, towards the sensor."""
        return self.prepared.normals

    @property
    def memo(self) -> dict[Hashable, Any]:
        """That of the prepared scan."""
        return self.prepared.memo

    def __len__(self) -> int:
        return len(self.prepared)


@dataclass(frozen=True, eq=False)
class Description:
    """Places of one scan and what they look like, made by a descriptor beside FPFH.

    keypoints: (N, 3) [m] in the scan's frame, any places; descriptors: (N, D), D at least 2, the same for all scans.
    Only their directions are compared; rows of zeros match nothing. memo: search structures, built on first use.
    """

    keypoints: Array
    descriptors: NDArray[np.float32]
    memo: dict[Hashable, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        _freeze(self, "keypoints", np.float64, (None, 3))
        _freeze(self, "descriptors", np.float32, (len(self.keypoints), None))

    def __len__(self) -> int:
        return len(self.keypoints)


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Matched point pairs: row c says that source_points[c] and target_points[c] may be the same place.

    source_points, target_points: (C, 3) [m], each in its own scan's frame; distance: (C,) in descriptor space,
    smaller is better (zeros where the matcher gives none).
    """

    source_points: Array
    target_points: Array
    distance: Array

    def __post_init__(self) -> None:
        _freeze(self, "source_points", np.float64, (None, 3))
        _freeze(self, "target_points", np.float64, (len(self.source_points), 3))
        _freeze(self, "distance", np.float64, (len(self.source_points),))

    @classmethod
    def from_points(cls, source_points: ArrayLike, target_points: ArrayLike) -> Correspondences:
        """Wrap correspondences computed elsewhere (learned descriptors): two (C, 3) arrays [m]."""
        source = frozen_array(source_points, np.float64, "source_points", (None, 3))
        target = frozen_array(target_points, np.float64, "target_points", (len(source), 3))
        return cls(source, target, np.zeros(len(source)))

    @classmethod
    def of_all(cls, sets: Sequence[Correspondences]) -> Correspondences:
        """All rows of at least one set, one set after the other."""
        if len(sets) == 1:
            return sets[0]
        names = (f.name for f in fields(cls))
        return cls(*(np.concatenate([getattr(each, name) for each in sets]) for name in names))

    def __len__(self) -> int:
        return len(self.source_points)


@dataclass(frozen=True, eq=False)
class HypothesisSet:
    """Candidate poses, best first.

    T_target_source: (H, 4, 4); num_inliers: (H,) correspondences within the inlier threshold;
    score: (H,) of the ranking metric, larger is better.
    """

    T_target_source: Array
    num_inliers: IndexArray
    score: Array

    def __post_init__(self) -> None:
        _freeze(self, "T_target_source", np.float64, (None, 4, 4))
        _freeze(self, "num_inliers", np.int64, (len(self.T_target_source),))
        _freeze(self, "score", np.float64, (len(self.T_target_source),))

    def __len__(self) -> int:
        return len(self.T_target_source)


NO_HYPOTHESES = HypothesisSet(np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros(0))
