"""When each point of a sweep was measured, from the field that the driver wrote."""

from __future__ import annotations

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.io.clouds.columns import Column

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp")  # in this order where a cloud has several

_LONGEST_SWEEP_S = 2.0  # separates offsets from absolute stamps, and one clock from another


def offsets_from_stamp(values: Column, stamp_ns: int) -> Array | None:
    """Turn time values (N,) into offsets (N,) [s] from the header stamp.

    Integers are offsets in ns (Ouster `t`, Livox `offset_time`). Floating-point numbers are the first of these that
    keeps every point within 2 s of the stamp: offsets in s (Velodyne `time`), absolute s (Hesai, RoboSense
    `timestamp`), absolute ns (Livox `timestamp`). None where no reading does, or a value is NaN: the values are of
    another clock or no times at all, and a wrong time is worse than none.
    """
    if values.dtype.kind in "iu":
        return values * 1e-9
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    with np.errstate(invalid="ignore", over="ignore"):
        t = values.astype(np.float64)
        for offsets in (t, (t - seconds) - nanoseconds * 1e-9, (t - float(stamp_ns)) * 1e-9):
            if np.abs(offsets).max(initial=0.0) <= _LONGEST_SWEEP_S:
                return offsets
    return None
