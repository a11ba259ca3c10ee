"""What messages and scan files have in common: columns of x, y, z as they were stored, and the points in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
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


def xyz_places(names: Sequence[str]) -> list[int]:
    """Where x, y and z stand, or X, Y and Z where there are no small ones; UnsupportedCloudError as `field_index`."""
    small = [name.lower() for name in names]
    return [field_index(names if name in names else small, name) for name in "xyz"]


def columns_from_text(
    lines: Sequence[str],
    num_values: int,
    wanted: Sequence[int],
    place: Callable[[int], str] = lambda number: f"point {number}",
) -> list[Array]:
    """Parse lines of `num_values` values each, apart by blanks, and return the wanted columns, (len(lines),) each.

    place: what to call the line of a number. UnsupportedCloudError where a line has more or fewer values, or a wanted
    one is no number.
    """
    for number, line in enumerate(lines):
        found = len(line.split())
        if found != num_values:
            raise UnsupportedCloudError(f"expected {num_values} values a point, found {found} at {place(number)}")
    if not lines:
        return [np.empty(0) for _ in wanted]
    try:
        return list(np.loadtxt(lines, usecols=wanted, comments=None, ndmin=2).T)
    except ValueError as error:
        told = re.search(r"string (.*) to \w+ at row (\d+)", str(error))
        found_text = f"{told[1]:.40} at {place(int(told[2]))}" if told else f"{error!s:.80}"
        raise UnsupportedCloudError(f"expected numbers, found text: {found_text}") from None


def text_lines(data: bytes, first: int, count: int) -> list[str]:
    """Return lines `first` to `first + count` of those that are not blank; UnsupportedCloudError if there are fewer."""
    lines = [line for line in data.decode("ascii", "replace").split("\n") if line.strip()][first:]
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
