"""When each point of a sweep was measured, from the field that the driver wrote. docs/formats.md lists the drivers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.scan import Array
from svc_ros.io.clouds.columns import Column

# In this order where a cloud has several.
TIME_FIELDS = (
    "t", "time", "timestamp", "offset_time", "time_stamp", "ts", "time_offset_ns", "point_time_offset",
)  # fmt: skip

_FARTHEST_S = 2.0  # from the stamp; separates offsets from absolute times, and one clock from another
_TOUCHING_S = 0.25  # a sweep begins or ends so near to its stamp
_SWEEP_S = (0.01, 0.5)  # how long a sweep may take where that tells the unit: of two, a thousand apart, one at most
_COARSEST_S = 2e-3  # a float32 of seconds since 1970 counts in steps of two minutes
_LARGEST = int(np.iinfo(np.int64).max)
_SECOND, _UNITS_NS = 1_000_000_000, (1, 1_000, 1_000_000, 1_000_000_000)


def offsets_from_stamp(values: Column, stamp_ns: int) -> Array | None:
    """Turn time values (N,) into offsets (N,) [s] from the header stamp, before or after it.

    The unit is the one, of ns, us, ms and s, in which the sweep takes 10 to 500 ms; where it takes that in none, ns for
    integers and s for floating-point numbers. They count from the stamp, or from the beginning of its clock: whichever
    comes within a quarter of a second of the stamp, in this order, else within 2 s. None where no reading does, a value
    is NaN, or steps are too coarse: the values are of another clock or no times at all, and a wrong time is worse than
    none.
    """
    is_whole = values.dtype.kind in "iu"
    if not values.size:
        return np.zeros(0)
    farther = None
    with np.errstate(invalid="ignore", over="ignore"):
        t = values.astype(np.int64 if is_whole else np.float64)
        steps = 1.0 if is_whole else float(np.spacing(np.abs(values).max()))
        for unit_ns, offsets in _readings(t, stamp_ns, is_whole):
            low, high = offsets.min(), offsets.max()
            if steps * unit_ns > _COARSEST_S * _SECOND or not -_FARTHEST_S <= low <= high <= _FARTHEST_S:
                continue
            if low <= _TOUCHING_S and high >= -_TOUCHING_S:
                return offsets
            farther = offsets if farther is None else farther
    return farther


def _readings(t: NDArray[Any], stamp_ns: int, is_whole: bool) -> Iterator[tuple[int, Array]]:
    """Unit [ns] and offsets (N,) [s] of every reading of the values t (N,), the likeliest first."""
    span = float(t.max()) - float(t.min())
    told = [unit_ns for unit_ns in _UNITS_NS if _SWEEP_S[0] <= span * unit_ns / _SECOND <= _SWEEP_S[1]]
    for unit_ns in told or [1 if is_whole else _SECOND]:
        yield unit_ns, t * (unit_ns / _SECOND)
    for unit_ns in told or (_SECOND, 1, 1_000, 1_000_000):
        whole, rest_ns = divmod(stamp_ns, unit_ns)
        if abs(whole) > _LARGEST:  # a broken stamp
            continue
        yield unit_ns, (t - whole) * (unit_ns / _SECOND) - rest_ns * 1e-9
