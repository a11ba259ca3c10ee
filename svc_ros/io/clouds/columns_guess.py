"""How many columns a file of bare numbers has, and of which type, by what the numbers say.

Every column has a distribution of its own. Read with the right number of columns, the place of a value within its
point tells most about the value; with a wrong one, columns are mixed, and it tells little. That needs no order of the
points. What is found has to look like coordinates too: one test alone is not enough against noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.core.scan import Array
from svc_ros.io.clouds.layout import KITTI, Layout

NAME_THEM = "name them, as --columns x,y,z,intensity,ring does (`columns` in a dataset.json)"
LARGEST_M = 1e7  # map coordinates are smaller, times since 1970 larger

_NUM_COLUMNS = (3, 4, 5, 6)
_MOST_COLUMNS = 16  # that are looked for, so that other layouts are known as such
_FEWEST_VALUES = 512  # below, chance looks like columns; KITTI's are the likely ones and need fewer
_FEWEST_FOR_KITTI = 16
_BLOCKS, _BLOCK_VALUES = 8, 2048  # of the file are looked at
_MOST_BINS = 24
_LEAST_BITS = 0.05  # that the place in the point has to tell about a value
_SAME_BITS = 0.85  # of the most that any number of columns tells: a multiple of the right one tells some more
_TINIEST = 1e-6  # [m] apart from zero: bytes of another type hardly ever lie between this and the largest
_MOST_ODD = 0.02  # share of such values in a coordinate
_MOST_TORN = 0.5  # share of points of which one or two coordinates are NaN
_BOTH_SIGNS = 0.02  # share of either sign, above which a column has both
_FEWEST_DISTINCT = 200  # values in a coordinate; labels, rings and 8 bit intensities have fewer or little more
_SMALLEST_SPAN = 0.3  # [m] of a coordinate; times of a sweep have less
_UNIT = 0.02  # how far from 1 a normal may be
_SAME_TURN = float(np.radians(10.0))  # between points that were measured together
_COMMON_RANGE = 0.3  # of the ranges of two columns that are the same one
_NEAR = 0.5  # of the distance between any two points


def guess_layout(data: bytes) -> Layout:
    """Tell the columns of bare numbers: x y z first, 3 to 6 columns of float32 or float64.

    UnsupportedCloudError where none or more than one layout fits, or the file is cut. A file of few points is read in
    KITTI's layout, if its size and numbers fit no other.
    """
    with np.errstate(invalid="ignore"):  # bytes of something else hold NaN that signal
        fitting = [layout for layout in (_fitting(data, "float32"), _fitting(data, "float64")) if layout]
    if not fitting and len(data) < _FEWEST_VALUES * KITTI.dtype.itemsize:
        fitting = _fitting_few(data)
    if len(fitting) != 1 and data and not len(data) % KITTI.point_bytes and _is_nothing(_table(data, KITTI)[:, :3]):
        return KITTI
    if len(fitting) == 1 and not len(data) % fitting[0].point_bytes:
        return fitting[0]
    if len(fitting) == 1 or (not fitting and len(data) % KITTI.point_bytes):
        expected = fitting[0] if fitting else KITTI
        raise UnsupportedCloudError(
            f"truncated, or other columns than {expected}: expected a multiple of {expected.point_bytes} bytes, found "
            f"{len(data)}; {NAME_THEM}"
        )
    found = " and ".join(map(str, fitting)) + " fit" if fitting else "that the numbers fit none, or do not tell"
    raise UnsupportedCloudError(
        f"expected 3, 4, 5 or 6 columns of float32 or float64 that begin with x, y, z, found {found}; where these are "
        f"points, {NAME_THEM}"
    )


def contradicts(data: bytes, layout: Layout) -> Layout | None:
    """Another layout that the numbers clearly are of, None where they do not clearly contradict."""
    if len(data) < _FEWEST_VALUES * layout.dtype.itemsize or _is_nothing(_table(data, layout)[:, layout.xyz]):
        return None
    try:
        found = guess_layout(data)
    except UnsupportedCloudError:
        return None
    return found if (found.dtype, len(found.names)) != (layout.dtype, len(layout.names)) else None


def _layout_of(num_columns: int, type_name: str) -> Layout:
    names = {4: KITTI.names, 3: KITTI.names[:3]}
    more = (*KITTI.names, *(f"column_{i}" for i in range(5, num_columns + 1)))
    return Layout(names.get(num_columns, more), type_name)


def _table(data: bytes, layout: Layout) -> NDArray[Any]:
    """(N, columns) without what follows the last whole point."""
    whole = len(data) // layout.point_bytes * len(layout.names)
    return np.frombuffer(data, layout.dtype, whole).reshape(-1, len(layout.names))


def _fitting(data: bytes, type_name: str) -> Layout | None:
    """The only number of columns that values of this type can have; the file may end within a point."""
    dtype = Layout(KITTI.names, type_name).dtype
    values = np.frombuffer(data, dtype, len(data) // dtype.itemsize)
    if len(values) < _FEWEST_VALUES or _are_halves(data) != (type_name == "float64"):
        return None
    period = _period(values)
    if not period:
        return None
    rows = values[: len(values) // period * period].reshape(-1, period)
    sample = np.asarray(rows[:: max(1, len(rows) // _BLOCK_VALUES)], np.float64)
    divisors = [d for d in range(2, period) if period % d == 0]
    num_columns = next((d for d in divisors if _repeats(sample, d)), period)
    if num_columns not in _NUM_COLUMNS:
        return None
    if num_columns == 3 < period and not _have_both_signs(sample[:, 3:5]).all():
        return None  # 6 columns of which two happen to be large
    fits = _are_coordinates(sample[:, :3]) and _are_no_coordinates(sample[:, 3:num_columns], sample[:, :3])
    return _layout_of(num_columns, type_name) if fits else None


def _are_halves(data: bytes) -> bool:
    """Whether every other float32 is the lower half of a float64: zero or of a size that lengths do not have."""
    words = np.frombuffer(data, "<f4", len(data) // 4)[::2]
    sample = np.abs(words[:: max(1, len(words) // _BLOCK_VALUES)].astype(np.float64))
    return bool(((sample <= _TINIEST) | (sample > LARGEST_M)).mean() > 0.5)


def _repeats(rows: Array, num_columns: int) -> bool:
    """Whether each row (N, period) is of several points: columns have the ranges of the first point, but for z, and
    x and y are near each other.

    That is so where a sensor fires its beams in turns, and those of every second one look higher than the others.
    """
    usable = rows[np.isfinite(rows).all(axis=1) & rows[:, :2].any(axis=1)]
    if len(usable) < 2:
        return False
    first, second = usable[:, :num_columns], usable[:, num_columns : 2 * num_columns]
    (low, low_2), (high, high_2) = (np.quantile([first, second], share, axis=1) for share in (0.1, 0.9))
    common, both = np.minimum(high, high_2) - np.maximum(low, low_2), np.maximum(high, high_2) - np.minimum(low, low_2)
    alike = (common >= _COMMON_RANGE * both)[np.arange(num_columns) != 2]
    turns = [np.arctan2(points[:, 1], points[:, 0]) for points in (first, second)]
    off = np.abs((turns[1] - turns[0] + np.pi) % (2 * np.pi) - np.pi)
    step, any_step = (np.abs(first - other)[:, :2].mean(axis=0) for other in (second, second[::-1]))
    return bool(alike.all() and (np.median(off) < _SAME_TURN or (step < _NEAR * any_step).all()))


def _fitting_few(data: bytes) -> list[Layout]:
    """KITTI's layout if no other fits so few numbers, or its columns tell most; else all that fit."""
    if not data:
        return []
    layouts = [_layout_of(k, "float64" if _are_halves(data) else "float32") for k in _NUM_COLUMNS]
    whole = [layout for layout in layouts if not len(data) % layout.point_bytes]
    tables = [np.asarray(_table(data, layout)[:, :3], np.float64) for layout in whole]
    told = [_are_lengths(xyz) and np.isfinite(xyz).all(axis=1).mean() > 0.5 for xyz in tables]
    fitting = [layout for layout, fits in zip(whole, told, strict=True) if fits]
    values = np.frombuffer(data, KITTI.dtype, len(data) // KITTI.dtype.itemsize)
    if fitting == [KITTI] or (KITTI in fitting and len(values) >= _FEWEST_FOR_KITTI and _period(values) == 4):
        return [KITTI]
    return fitting if len(fitting) > 1 else []


def _period(values: NDArray[Any]) -> int:
    """Number of columns that tells most about the values, 0 where none tells anything."""
    bits = _bits_by_columns(values)
    return int(np.flatnonzero(bits >= _SAME_BITS * bits.max())[0]) + 1 if bits.max() >= _LEAST_BITS else 0


def _bits_by_columns(values: NDArray[Any]) -> Array:
    """(_MOST_COLUMNS,) bits that the place in the point tells about a value, for 1 column, 2 columns ..."""
    places = np.arange(len(values))
    if len(values) > _BLOCKS * _BLOCK_VALUES:
        starts = np.linspace(0, len(values) - _BLOCK_VALUES, _BLOCKS).astype(int)
        places = (starts[:, None] + np.arange(_BLOCK_VALUES)).ravel()
    bins = _bins(values[places])
    num_bins = int(bins.max()) + 1
    bits = np.zeros(_MOST_COLUMNS)
    for k in range(2, _MOST_COLUMNS + 1):
        counts = np.bincount(places % k * num_bins + bins, minlength=k * num_bins).reshape(k, num_bins)
        used = int((counts.sum(0) > 0).sum())
        chance = (k - 1) * (used - 1) / (2 * len(places) * np.log(2))  # what a finite sample tells about nothing
        bits[k - 1] = _entropy(counts.sum(0)) + _entropy(counts.sum(1)) - _entropy(counts) - chance
    return bits


def _bins(values: NDArray[Any]) -> NDArray[np.int64]:
    """Bin of each value by quantiles; values that fill a border, such as zeros, and NaN have bins of their own."""
    finite = values[np.isfinite(values)]
    num_bins = int(np.clip(np.sqrt(len(values) / _MOST_COLUMNS), 4, _MOST_BINS))
    shares = np.linspace(0, 1, num_bins + 1)[1:-1]
    borders = np.unique(np.quantile(finite, shares, method="nearest")) if len(finite) else finite
    bins = np.searchsorted(borders, values, "left") + np.searchsorted(borders, values, "right")
    return np.where(np.isfinite(values), bins, 2 * len(borders) + 1)


def _entropy(counts: NDArray[np.int64]) -> float:
    """[bit]"""
    p = counts[counts > 0] / counts.sum()
    return float(-(p * np.log2(p)).sum())


def _are_lengths(xyz: Array) -> bool:
    """Whether (N, 3) values may be metres: of usable size, and NaN in all three or none, but for a few."""
    finite = np.isfinite(xyz)
    sizes = np.abs(xyz[finite])
    odd = ((sizes < _TINIEST) & (sizes > 0)) | (sizes > LARGEST_M)
    torn = finite.any(axis=1) & ~finite.all(axis=1)
    return bool(len(sizes) and odd.mean() <= _MOST_ODD and torn.mean() <= _MOST_TORN)


def _are_coordinates(xyz: Array) -> bool:
    points = xyz[np.isfinite(xyz).all(axis=1)]
    points = points[points.any(axis=1)]
    if not _are_lengths(xyz) or len(points) < _FEWEST_VALUES // _MOST_COLUMNS:
        return False
    most = min(_FEWEST_DISTINCT, len(points) // 2)
    distinct = all(len(np.unique(column)) >= most for column in points.T)
    return distinct and bool(_are_wide(points).all())


def _are_no_coordinates(more: Array, xyz: Array) -> bool:
    """Whether columns after x y z are no coordinates: not wide and of both signs, and not three of fractions like a
    second point, unless these are normals or colours from 0 to 1; copies of x, y and z are no further ones."""
    copied = (more[:, :, None] == xyz[:, None, :]).all(axis=0).any(axis=1)
    more = more[np.isfinite(more).all(axis=1)][:, ~copied]
    if more.shape[1] == 3 and float((np.abs(np.linalg.norm(more, axis=1) - 1) < _UNIT).mean()) > 1 - _BOTH_SIGNS:
        return True
    second_point = more.shape[1] == 3 and ((more % 1 != 0).mean(axis=0) > 0.5).all() and more.max(initial=0.0) > 1
    return not (_have_both_signs(more) & _are_wide(more)).any() and not second_point


def _are_wide(columns: Array) -> NDArray[np.bool_]:
    low, high = np.quantile(columns, [0.01, 0.99], axis=0) if len(columns) else np.zeros((2, columns.shape[1]))
    return np.asarray(high - low > _SMALLEST_SPAN)


def _have_both_signs(columns: Array) -> NDArray[np.bool_]:
    lower, upper = (np.mean(side, axis=0) > _BOTH_SIGNS for side in (columns < 0, columns > 0))
    return np.asarray(lower & upper)


def _is_nothing(xyz: NDArray[Any]) -> bool:
    """Whether no point is usable, which is told in other words than columns that do not fit."""
    return not np.nan_to_num(xyz, posinf=0, neginf=0).any()
