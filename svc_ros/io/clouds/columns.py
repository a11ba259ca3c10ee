"""What messages and scan files have in common: columns of x, y, z as they were stored, and the points in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.core.scan import Array

Column = NDArray[Any]  # numbers of any type and byte order, often a strided view into the bytes it came from


class RawPoints(NamedTuple):
    """Columns of x, y and z [m] as stored, and where the sensor stood in the same frame [m]."""

    xyz: Sequence[Column]
    sensor_origin: tuple[float, float, float] = (0.0, 0.0, 0.0)


class CleanPoints(NamedTuple):
    """Usable points.

    points: (M, 3) [m]; keep: (N,) which of the stored points they are; num_nan: stored points with NaN or inf;
    num_zero: stored points at exactly 0, 0, 0, which is how many drivers write a beam without return; out_of_range:
    (N,) those of num_nan whose coordinates are all +inf: the beam met nothing within range (REP 117).
    """

    points: Array
    keep: NDArray[np.bool_]
    num_nan: int
    num_zero: int
    out_of_range: NDArray[np.bool_]


def clean_points(xyz: Sequence[Column]) -> CleanPoints:
    """Join three columns of N values in any shape (rows of an organised cloud are joined) and drop what is no point."""
    columns = np.empty((3, xyz[0].size))
    with np.errstate(invalid="ignore"):  # a signalling NaN, widened to double
        for row, values in zip(columns, xyz, strict=True):
            row.reshape(values.shape)[...] = values
    finite = np.isfinite(columns[0]) & np.isfinite(columns[1]) & np.isfinite(columns[2])
    zero = (columns[0] == 0) & (columns[1] == 0) & (columns[2] == 0)
    keep = finite & ~zero
    kept = columns if keep.all() else columns[:, keep]
    beyond = ~finite & (columns == np.inf).all(0) if not finite.all() else np.zeros_like(finite)
    return CleanPoints(np.ascontiguousarray(kept.T), keep, int((~finite).sum()), int(zero.sum()), beyond)


def field_index(names: Sequence[str], wanted: str) -> int:
    """Return where `wanted` stands among `names`; UnsupportedCloudError unless it stands there exactly once."""
    places = [i for i, name in enumerate(names) if name == wanted]
    if len(places) != 1:
        shown = (name if name.isprintable() else repr(name) for name in names)
        listed = ", ".join(shown) if names else "no fields at all"
        raise UnsupportedCloudError(f"expected one field '{wanted}', found {len(places)} in: {listed:.200}")
    return places[0]


def columns_from_text(lines: Sequence[bytes], num_values: int, wanted: Sequence[int]) -> list[Array]:
    """Parse lines of `num_values` numbers each and return the wanted columns, (len(lines),) each."""
    rows = [line.split() for line in lines]
    for number, row in enumerate(rows):
        if len(row) != num_values:
            raise UnsupportedCloudError(f"expected {num_values} values a point, found {len(row)} at point {number}")
    try:
        return [np.array([float(row[i]) for row in rows], np.float64) for i in wanted]
    except ValueError as error:
        raise UnsupportedCloudError(f"expected numbers, found text: {error}") from None


def text_lines(data: bytes, first: int, count: int) -> list[bytes]:
    """Return lines `first` to `first + count` of those that are not blank; UnsupportedCloudError if there are fewer."""
    lines = [line for line in data.splitlines() if line.strip()][first:]
    if len(lines) < count:
        raise UnsupportedCloudError(f"truncated: expected {count} lines of points, found {len(lines)}")
    return lines[:count]


def strided_columns(
    data: NDArray[np.uint8], count: int, dtypes: Sequence[np.dtype[Any]], offsets: Sequence[int], strides: Sequence[int]
) -> list[Column]:
    """View `count` values a column in `data` without a copy; the caller has checked that they lie inside."""
    if not count:
        return [np.empty(0) for _ in dtypes]
    return [
        np.ndarray((count,), dtype, data, offset, (stride,))
        for dtype, offset, stride in zip(dtypes, offsets, strides, strict=True)
    ]
