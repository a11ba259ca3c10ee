"""Livox' own message, read from its bytes, against a slow reader that asks each point object."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from livox_messages import LivoxScan, fast_cdr, livox_types
from yardstick import Stopwatch

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.livox import LIVOX_TYPE, cloud_from_cdr
from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud
from svc_ros.io.stamps import ns_from_stamp

POINTS = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0], [-4.0, 5.5, 6.25], [np.nan, 1.0, 1.0], [7.0, -8.0, 9.0]])
TIMES_NS = [0, 1000, 2_000_000, 3_000_000, 4_000_000_000 % 2**32 // 40]
SCAN = LivoxScan(POINTS, TIMES_NS)


def read(data: bytes) -> CloudReading:
    return scan_from_cloud(cloud_from_cdr(data))


def assert_reads_as(reading: CloudReading, message: Any) -> None:
    """The slow twin: every point of the message object is asked for its numbers."""
    rows = np.array([(p.x, p.y, p.z) for p in message.points], np.float64).reshape(-1, 3)
    times_s = np.array([p.offset_time * 1e-9 for p in message.points])
    keep = np.isfinite(rows).all(1) & (rows != 0).any(1)
    scan = reading.scan
    np.testing.assert_array_equal(scan.points, rows[keep])
    assert scan.point_times_s is not None
    np.testing.assert_array_equal(scan.point_times_s, times_s[keep])
    assert (scan.stamp_ns, scan.frame_id) == (ns_from_stamp(message.header.stamp), message.header.frame_id)
    assert (reading.num_points, reading.time_field) == (len(rows), "offset_time")


@pytest.mark.parametrize("frame_id", ["", "a", "livox", "livox_frame", "livox_frame_2"])  # each moves what follows
@pytest.mark.parametrize("little_endian", [True, False])
def test_points_times_stamp_and_frame(frame_id: str, little_endian: bool) -> None:
    scan = LivoxScan(POINTS, TIMES_NS, frame_id=frame_id)
    reading = read(scan.cdr(little_endian))
    assert_reads_as(reading, scan.message())
    assert (reading.num_dropped_nan, reading.num_dropped_zero) == (1, 1)


def test_the_recorded_example(shared_data: Any) -> None:
    from rosbags.highlevel import AnyReader

    folder = shared_data / "inputs" / "bags" / "livox_custom"
    if not folder.is_dir():
        pytest.skip(f"no bag {folder}")
    with AnyReader([folder]) as reader:
        clouds = [(bytes(raw), reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]
    assert len(clouds) == 4
    for raw, message in clouds:
        assert_reads_as(read(raw), message)


def test_no_points_are_an_empty_scan() -> None:
    reading = read(LivoxScan(np.zeros((0, 3)), []).cdr())
    assert (reading.num_points, len(reading.scan)) == (0, 0)
    assert reading.scan.frame_id == "livox_frame"


def test_the_list_tells_how_many_points_there_are() -> None:
    message = SCAN.message()
    message.point_num = 99
    assert_reads_as(read(bytes(livox_types().serialize_cdr(message, LIVOX_TYPE))), message)


@pytest.mark.parametrize("num_missing", [1, 19, 60])
def test_points_that_are_cut_off_are_refused_as_in_any_cloud(num_missing: int) -> None:
    with pytest.raises(UnsupportedCloudError, match=r"frame 'livox_frame' at 17000.*truncated data: expected 100 "):
        read(SCAN.cdr()[:-num_missing])


@pytest.mark.parametrize("size", [4, 10, 20, 40])
def test_a_header_that_is_cut_off_is_refused(size: int) -> None:
    with pytest.raises(UnsupportedCloudError, match=r"truncated message: expected at least \d+ bytes, found"):
        cloud_from_cdr(SCAN.cdr()[:size])


def test_another_encapsulation_is_refused() -> None:
    with pytest.raises(UnsupportedCloudError, match="expected plain CDR"):
        cloud_from_cdr(b"\x00\x07\x00\x00" + SCAN.cdr()[4:])


def test_a_hundred_thousand_points_are_read_in_a_moment() -> None:
    points = np.random.default_rng(0).normal(size=(100_000, 3))
    data = fast_cdr(points, np.arange(100_000) * 1000, 1_700_000_000_000_000_000)
    read(data)
    start, took_s = time.monotonic(), []
    while len(took_s) < 5 and time.monotonic() < start + 10.0:
        with Stopwatch() as watch:
            reading = read(data)
        took_s.append(watch.own_s)
    assert len(reading.scan) == 100_000
    assert min(took_s) < 0.1  # objects of all points take three times as long to make
