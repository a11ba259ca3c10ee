"""Range images: how far a sensor looked in every direction.

Of the raw points of a scan, not of the thinned ones: each cell of directions keeps the least and the greatest range of
itself and its neighbours, so that edges, grazing ground and noise are covered by what the sensor itself measured there,
without a model of incidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import InputError
from svc_ros.core.kernels import range_image as range_image_kernels

Array = NDArray[np.float64]
Tables = tuple[NDArray[np.int16], NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]
Size = tuple[float, float]

_RISE_STEPS, _TURN_STEPS = 8192, 2048  # a few hundredths of a degree at most
_LEAST_HELD = 4  # of nine cells: with fewer the sensor has hardly looked there
_SMALLEST_DEG, _LARGEST_DEG = 0.4, 2.5
_BEAMS = 1.05  # cells are a little higher than beams are apart, so that none falls between two of them
# Of the cells with a point so many have others around them, and so many are seen; else cells are too small for the
# pattern. (At the upper and the lower border of the view nothing is seen: of 16 beams that is an eighth.)
_ENOUGH_DENSE, _ENOUGH_SEEN = 0.9, 0.6
_LARGER = 1.5
_BEHIND_RATIO, _BEHIND_M = 1.5, 1.0  # a point so much behind another one in its direction was seen through it
_CROSSED_DEG = 0.5
_ENOUGH_POINTS = 500_000  # to tell that surfaces lie behind each other
_FEWEST_CELLS = 50  # with several points; fewer say nothing about all


@dataclass(frozen=True, eq=False)
class RangeImage:
    """Least and greatest range of the directions around a sensor, over a cell and the eight around it.

    near, far: (C,) float32 [m], both -1 where the sensor did not look (fewer than four of the nine cells hold a point);
    tables: rows by the rise of a direction, turns by the quadrant's share, number of cells and first cell of every
    row: rows have fewer cells the nearer they are to a pole, so that all are about as wide; size_deg: height and width
    of a cell; dense_ratio, seen_ratio: of the cells with a point, those with four held ones among the nine, and those
    that are not -1; crossed_ratio: of the directions (cells of half a degree, whatever the size of these) with several
    ranges, those with one far behind another; 0 where too few tell, and of an image whose cells were kept.
    """

    near: NDArray[np.float32]
    far: NDArray[np.float32]
    tables: Tables
    size_deg: Size
    dense_ratio: float
    seen_ratio: float
    crossed_ratio: float = 0.0


def build_range_image(points: Array, origin: Array, min_range_m: float, beam_spacing_deg: float) -> RangeImage:
    """The image of raw points (N, 3) [m] around the sensor at origin (3,); nearer ones (the carrier) do not count.

    Cells are as high as beams are apart, and larger where the pattern is sparser than that: a wider or a higher one,
    whichever helps more, until most points have others around them; then higher ones, until they have some above and
    below, as rings that jitter seem nearer to each other than they are.
    """
    height = min(max(_BEAMS * beam_spacing_deg, _SMALLEST_DEG), _LARGEST_DEG)
    image = _build(points, origin, min_range_m, (height, _SMALLEST_DEG))
    while image.dense_ratio < _ENOUGH_DENSE and min(image.size_deg) < _LARGEST_DEG:
        larger = (size for size in _larger(image.size_deg) if size != image.size_deg)
        image = max((_build(points, origin, min_range_m, size) for size in larger), key=lambda tried: tried.dense_ratio)
    while image.seen_ratio < _ENOUGH_SEEN and image.size_deg[0] < _LARGEST_DEG:
        image = _build(points, origin, min_range_m, _larger(image.size_deg)[1])
    return replace(image, crossed_ratio=_crossed_ratio(points, origin, min_range_m))


def restore_range_image(
    near: NDArray[np.float32], far: NDArray[np.float32], size_deg: Size, rows: tuple[int, int], shares: Size
) -> RangeImage:
    """An image of which its cells were kept: near, far (C,) [m] and the size of cells [deg] as it had them.

    rows: `rows_of` that image; shares: its dense and its seen ratio. Raises InputError where the cells are none of
    such an image.
    """
    tables = _cut(size_deg, rows)
    if not len(near) == len(far) == int(tables[2].sum()):
        raise InputError(
            f"range image: expected {int(tables[2].sum())} cells in {rows[1]} rows of {size_deg[0]:g} x "
            f"{size_deg[1]:g} deg, found {len(near)} and {len(far)}"
        )
    return RangeImage(near, far, tables, size_deg, *shares)


def rows_of(image: RangeImage) -> tuple[int, int]:
    """Which of all rows of cells the image has: the first, counted from straight down, and how many."""
    kept = image.tables[0]
    inside = np.flatnonzero(kept >= 0)
    if len(inside) == 0:
        return 0, 0
    return int(_tables(image.size_deg)[0][inside[0]] - kept[inside[0]]), len(image.tables[2])


def _larger(size_deg: Size) -> tuple[Size, Size]:
    """Cells that are wider, and cells that are higher."""
    height, width = size_deg
    return (height, min(_LARGER * width, _LARGEST_DEG)), (min(_LARGER * height, _LARGEST_DEG), width)


def _build(points: Array, origin: Array, min_range_m: float, size_deg: Size) -> RangeImage:
    tables = _tables(size_deg)
    near, far = _fill(points, origin, min_range_m, tables)
    rows, cells = _used_rows(tables, far)
    tables, near, far = _cut(size_deg, rows), near[cells], far[cells]
    wide_near, wide_far = np.empty_like(near), np.empty_like(far)
    num_held, num_dense, num_seen = range_image_kernels.spread(
        near, far, *tables[2:], _LEAST_HELD, wide_near, wide_far
    )  # fmt: skip
    shares = num_dense / max(num_held, 1), num_seen / max(num_held, 1)
    return RangeImage(wide_near, wide_far, tables, size_deg, *shares)


def _crossed_ratio(points: Array, origin: Array, min_range_m: float) -> float:
    """From where a scan was taken surfaces lie behind each other at edges only; from elsewhere they do all over.

    Larger cells than these hold several beams on grazing ground; smaller ones hold several points at edges only.
    """
    some = np.ascontiguousarray(points[:: 1 + len(points) // _ENOUGH_POINTS])
    near, far = _fill(some, origin, min_range_m, _tables((_CROSSED_DEG, _CROSSED_DEG)))
    several = far > near
    num_several = int(several.sum())
    if num_several < _FEWEST_CELLS:
        return 0.0
    near, far = near[several], far[several]
    return float(((far > _BEHIND_RATIO * near) & (far - near > _BEHIND_M)).sum() / num_several)


def _fill(
    points: Array, origin: Array, min_range_m: float, tables: Tables
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and greatest range of each cell of an image of all directions; inf and 0 where no point is."""
    num = int(tables[2].sum())
    near, far = np.full(num, np.inf, np.float32), np.zeros(num, np.float32)
    range_image_kernels.fill(points, origin, min_range_m, tables, near, far)
    return near, far


@lru_cache(maxsize=32)
def _tables(size_deg: Size) -> Tables:
    """Of an image of all directions."""
    height, width = np.radians(size_deg)
    num_rows = int(np.ceil(np.pi / height))
    rise = np.minimum((np.arange(_RISE_STEPS + 1) + 0.5) * (2.0 / _RISE_STEPS) - 1.0, 1.0)
    elevation = np.arctan2(rise, 1.0 - np.abs(rise))
    rows = np.minimum((elevation + 0.5 * np.pi) / height, num_rows - 1).astype(np.int16)
    middles = (np.arange(num_rows) + 0.5) * height - 0.5 * np.pi
    columns = np.maximum(np.round(2.0 * np.pi * np.cos(middles) / width), 4).astype(np.int32)
    starts = (np.cumsum(columns) - columns).astype(np.int32)
    share = (np.arange(_TURN_STEPS + 1) + 0.5) / _TURN_STEPS
    quarter = np.minimum(np.arctan2(share, 1.0 - share) / (2.0 * np.pi), 0.25)
    turns = np.array([quarter, 0.5 - quarter, 1.0 - quarter, 0.5 + quarter]) % 1.0
    return rows, turns.astype(np.float32), columns, starts


def _used_rows(tables: Tables, far: NDArray[np.float32]) -> tuple[tuple[int, int], slice]:
    """The rows from the lowest to the highest point, the first one and how many, and their cells."""
    *_, columns, starts = tables
    held = np.flatnonzero(far)
    if len(held) == 0:
        return (0, 0), slice(0, 0)
    first, last = (int(row) for row in np.searchsorted(starts, held[[0, -1]], side="right") - 1)
    return (first, last - first + 1), slice(int(starts[first]), int(starts[last] + columns[last]))


def _cut(size_deg: Size, used: tuple[int, int]) -> Tables:
    """The tables of some rows: the first one, and how many."""
    rows, turns, columns, starts = _tables(size_deg)
    first, num = used
    if num == 0:
        return np.full_like(rows, -1), turns, columns[:0], starts[:0]
    inside = (rows >= first) & (rows < first + num)
    kept = np.where(inside, rows - first, -1).astype(np.int16)
    return kept, turns, columns[first : first + num], starts[first : first + num] - starts[first]
