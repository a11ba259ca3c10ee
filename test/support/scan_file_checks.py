"""What every test of a scan file asserts: it is read exactly, or refused in one line without taking memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.files import read_scan

POINTS = np.array([[1.0, 2.0, 3.0], [-4.0, 5.5, 6.25], [7.0, -8.0, 9.0], [0.5, 0.0, 0.0]])
DROPPED = np.array([[np.nan, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, np.inf, 2.0]])
STORED = np.concatenate([DROPPED[:1], POINTS[:2], DROPPED[1:], POINTS[2:]])


def write(path: Path, data: bytes | str) -> Path:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def assert_read(path: Path, points: Any = POINTS, origin: Sequence[float] = (0, 0, 0)) -> None:
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.sensor_origin, origin)
    assert (scan.stamp_ns, scan.frame_id, scan.point_times_s) == (0, "", None)


def assert_refused(path: Path, *parts: str, error: type[Exception] = UnsupportedCloudError) -> None:
    """One line that names file and cause, and no memory taken for what a header merely claims."""
    tracemalloc.start()
    try:
        with pytest.raises(error) as caught:
            read_scan(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    for part in parts:
        assert part in message
    assert peak < 50e6
