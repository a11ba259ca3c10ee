"""Times of points by the conventions of drivers: each as the driver writes it, read as offsets from the stamp."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from cloud_messages import FLOAT32, FLOAT64, Column, pack, xyz_columns
from places import PROJECT_ROOT

from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud
from svc_ros.io.clouds.point_times import TIME_FIELDS, offsets_from_stamp

INT32, UINT32 = 5, 6
STAMP_NS = 1_732_831_200_123_456_789
STAMP_S = STAMP_NS / 1e9
NUM = 200
AFTER = np.linspace(0.0, 0.0999, NUM)  # the stamp is that of the first point
BEFORE = AFTER - 0.0999  # of the last one
POINTS = np.random.default_rng(0).uniform(1.0, 20.0, (NUM, 3))
CONVENTIONS = {
    "Ouster": ("t", UINT32, 1e9 * AFTER, AFTER),
    "Livox' own message": ("offset_time", UINT32, 1e9 * AFTER, AFTER),
    "Livox PointCloud2": ("timestamp", FLOAT64, STAMP_NS + 1e9 * AFTER, AFTER),
    "Velodyne, stamp of the last packet": ("time", FLOAT32, BEFORE, BEFORE),
    "Velodyne, stamp of the first packet": ("time", FLOAT32, AFTER, AFTER),
    "Hesai, RoboSense with ts_first_point": ("timestamp", FLOAT64, STAMP_S + AFTER, AFTER),
    "RoboSense, Seyond: stamp at the end": ("timestamp", FLOAT64, STAMP_S + BEFORE, BEFORE),
    "Nebula": ("time_stamp", UINT32, 1e9 * AFTER, AFTER),
    "SICK, seconds": ("ts", FLOAT32, AFTER, AFTER),
    "Blickfeld": ("point_time_offset", UINT32, 1e9 * AFTER, AFTER),
    "Aeva, before and after the stamp": ("time_offset_ns", INT32, 1e9 * (AFTER - 0.05), AFTER - 0.05),
    "ns as float64": ("time", FLOAT64, 1e9 * AFTER, AFTER),
    "ns as float32": ("time", FLOAT32, 1e9 * AFTER, AFTER),
    "ns before the stamp": ("t", INT32, 1e9 * BEFORE, BEFORE),
    "us": ("t", UINT32, 1e6 * AFTER, AFTER),
    "us as float32": ("time", FLOAT32, 1e6 * BEFORE, BEFORE),
    "us since 1970": ("timestamp", FLOAT64, STAMP_NS / 1e3 + 1e6 * AFTER, AFTER),
    "ms": ("time", FLOAT32, 1e3 * AFTER, AFTER),
    "ms since 1970": ("timestamp", FLOAT64, STAMP_NS / 1e6 + 1e3 * BEFORE, BEFORE),
}


def read(name: str, datatype: int, values: np.ndarray, stamp_ns: int = STAMP_NS) -> CloudReading:
    stored = np.round(values).astype(int) if datatype in (INT32, UINT32) else values
    cloud = pack([*xyz_columns(POINTS[: len(values)]), Column(name, stored.tolist(), datatype)])
    return scan_from_cloud(replace(cloud, stamp_ns=stamp_ns).message())


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_driver_writes_and_the_offsets_are_read(convention: str) -> None:
    name, datatype, values, offsets = CONVENTIONS[convention]
    reading = read(name, datatype, values)
    assert reading.time_field == name
    np.testing.assert_allclose(reading.scan.point_times_s, offsets, atol=2e-6)


@pytest.mark.parametrize("sweep_s", [0.012, 0.05, 0.2, 0.45])
@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_the_unit_is_told_by_how_long_a_sweep_takes(unit: float, sweep_s: float) -> None:
    offsets = np.linspace(-0.3 * sweep_s, 0.7 * sweep_s, NUM)
    np.testing.assert_allclose(offsets_from_stamp(unit * offsets, STAMP_NS), offsets, atol=1e-9)


@pytest.mark.parametrize("span_s", [0.0, 0.0013, 1.0])
def test_else_integers_are_ns_and_floats_are_seconds(span_s: float) -> None:
    """All points at one time, a packet, and a whole second."""
    offsets = np.linspace(0.0, span_s, NUM)
    whole = np.round(1e9 * offsets).astype(np.uint32)
    np.testing.assert_allclose(offsets_from_stamp(whole, STAMP_NS), offsets, atol=1e-9)
    np.testing.assert_allclose(offsets_from_stamp(offsets, STAMP_NS), offsets)


def test_absolute_times_of_a_clock_that_counts_from_its_start() -> None:
    stamp_s = 100.0
    found = offsets_from_stamp(np.round(1e6 * (stamp_s + AFTER)).astype(np.uint32), int(1e9 * stamp_s))
    np.testing.assert_allclose(found, AFTER, atol=1e-6)


def test_of_two_readings_the_one_that_touches_the_stamp_wins() -> None:
    """A simulated clock that has just begun: at 1 s both fit; at 0.1 s both touch, and the stamp is what counts."""
    np.testing.assert_allclose(offsets_from_stamp(1.0 + AFTER, 1_000_000_000), AFTER, atol=1e-12)
    np.testing.assert_allclose(offsets_from_stamp(AFTER, 1_000_000_000), AFTER)
    np.testing.assert_allclose(offsets_from_stamp(AFTER, 100_000_000), AFTER)


@pytest.mark.parametrize(
    ("datatype", "values"),
    [
        (FLOAT32, np.full(NUM, STAMP_S)),  # steps of two minutes: all points seem measured at one time
        (FLOAT64, STAMP_S - 3600.0 + AFTER),  # another clock
        (FLOAT64, 3600.0 + AFTER),  # since the sensor's start
        (UINT32, 3e9 + 1e9 * AFTER),  # the same in ns
        (FLOAT32, np.where(np.arange(NUM) == 7, np.nan, AFTER)),
        (FLOAT32, np.where(np.arange(NUM) == 7, np.inf, AFTER)),
    ],
)
def test_a_wrong_time_is_worse_than_none(datatype: int, values: np.ndarray) -> None:
    stamp_ns = 1_732_831_232_000_000_000  # a number that float32 has
    reading = read("timestamp", datatype, values, stamp_ns)
    assert (reading.scan.point_times_s, reading.time_field) == (None, "")


def test_the_page_lists_the_fields_in_their_order() -> None:
    page = (PROJECT_ROOT / "docs" / "formats.md").read_text("utf-8")
    found = re.search(r"<!-- time fields -->(.*)<!-- /time fields -->", page)
    assert found is not None
    assert tuple(re.findall(r"`(\w+)`", found[1])) == TIME_FIELDS
