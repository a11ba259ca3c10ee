"""The PointCloud2 reader on random and on real clouds, against slower ways to the same points."""

from __future__ import annotations

import struct
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloud_messages import CODES, FLAVOURS, Cloud, Field, xyz_cloud
from hypothesis import given, settings
from hypothesis import strategies as st

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.point_cloud2 import CloudReading, scan_from_cloud


def assert_points(reading: CloudReading, expected: Any) -> None:
    np.testing.assert_array_equal(reading.scan.points, np.asarray(expected, float).reshape(-1, 3))


# Any layout at all: read as a slow twin reads it, or refused


def slow_points(cloud: Cloud) -> tuple[list[tuple[float, ...]], int]:
    """Finite, non-zero points read value by value, and how many there were before."""
    order = "><"[not cloud.is_bigendian]
    xyz = [next(f for f in cloud.fields if f.name == name) for name in "xyz"] if cloud.width * cloud.height else []
    row_step = cloud.row_step if cloud.row_step and cloud.height > 1 else cloud.width * cloud.point_step
    starts = [row * row_step + i * cloud.point_step for row in range(cloud.height) for i in range(cloud.width)]
    points = [
        tuple(struct.unpack_from(order + CODES[f.datatype], cloud.data, start + f.offset)[0] for f in xyz)
        for start in starts
    ]
    return [p for p in points if np.isfinite(p).all() and any(p)], len(points)


@st.composite
def right_clouds(draw: st.DrawFn) -> Cloud:
    names = draw(st.permutations(["x", "y", "z", *draw(st.lists(st.sampled_from(["t", "time", "ring"]), unique=True))]))
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 5))
    fields, end = [], 0
    for name in names:
        datatype = draw(st.integers(1, 8))
        offset = end + draw(st.integers(0, 3))
        fields.append(Field(name, offset, datatype, draw(st.sampled_from([0, 1]))))
        end = offset + struct.calcsize(CODES[datatype])
    step = end + draw(st.integers(0, 5))
    row_step = width * step + draw(st.integers(0, 7))
    data = draw(st.randoms(use_true_random=False)).randbytes(height * row_step)
    return Cloud(tuple(fields), data, step, row_step, width, height, draw(st.booleans()))


@st.composite
def mutated_clouds(draw: st.DrawFn) -> Cloud:
    cloud = draw(right_clouds())
    for what in draw(st.lists(st.sampled_from(["fields", "data", "size"]), min_size=1, max_size=3)):
        if what == "data":
            cloud = replace(cloud, data=cloud.data[: draw(st.integers(0, len(cloud.data)))])
        elif what == "size":
            name = draw(st.sampled_from(["width", "height", "point_step", "row_step"]))
            old = getattr(cloud, name)
            values = st.sampled_from([0, 1, old - 1, old + 1, 2 * old, 2**32 - 1])
            cloud = replace(cloud, **{name: draw(values)})
        elif cloud.fields:
            i = draw(st.integers(0, len(cloud.fields) - 1))
            change = draw(
                st.sampled_from([{"name": "x"}, {"name": "q"}, {"count": 2}, {"datatype": 0}, {"datatype": 8}])
                | st.builds(lambda offset: {"offset": offset}, st.integers(0, cloud.point_step + 4))
            )
            fields = list(cloud.fields)
            fields[i : i + 1] = draw(st.sampled_from([[], [replace(fields[i], **change)]]))
            cloud = replace(cloud, fields=tuple(fields))
    return cloud


@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")
@settings(max_examples=200, derandomize=True, deadline=None)
@given(right_clouds())
def test_every_right_layout_is_read_as_the_slow_twin_reads_it(cloud: Cloud) -> None:
    reading = scan_from_cloud(cloud.message())
    expected, num_points = slow_points(cloud)
    assert_points(reading, expected)
    assert reading.num_points == num_points == len(expected) + reading.num_dropped_nan + reading.num_dropped_zero


@pytest.mark.filterwarnings("error", "ignore::ResourceWarning")
@settings(max_examples=600, derandomize=True, deadline=None)
@given(mutated_clouds())
def test_every_other_layout_is_read_as_the_slow_twin_reads_it_or_refused(cloud: Cloud) -> None:
    try:
        reading = scan_from_cloud(cloud.message())
    except UnsupportedCloudError:
        return
    assert_points(reading, slow_points(cloud)[0])


# Real clouds, and time


REAL_BAGS = {  # bag: scans, points of the first, of which NaN
    "readers/vlp16_pointcloud2": (4, 14885, 0),
    "readers/vlp32_pointcloud2": (5, 26330, 0),
    "readers/os0_8_10scans_pointcloud2": (10, 6156, 0),
    "readers/os1_128_pointcloud2_mcap": (3, 107647, 0),
    "readers/depth_ros1_padded_nan/perception_tutorial.bag": (1, 307200, 73899),
    "os0_64_walk/ros2_mcap": (89, 23058, 0),
    "os0_64_walk/ros1_first22.bag": (22, 23058, 0),
    "hdl64_kitti_a_10hz": (22, 59989, 0),
}


def structured_points(message: Any) -> np.ndarray:
    """Another way to the same floats: copy each row, drop its padding, look at 4-byte words."""
    data = np.array(message.data).reshape(message.height, message.row_step)[:, : message.width * message.point_step]
    words = np.ascontiguousarray(data).view("<f4").reshape(message.width * message.height, -1)
    points = words[:, :3].astype(float)
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


@pytest.mark.parametrize("bag", REAL_BAGS)
def test_real_bags(shared_data: Path, bag: str) -> None:
    from rosbags.highlevel import AnyReader

    readings = []
    with AnyReader([shared_data / "bags" / bag]) as reader:
        clouds = [c for c in reader.connections if c.msgtype.endswith("PointCloud2")]
        for connection, _, raw in reader.messages(clouds):
            message: Any = reader.deserialize(raw, connection.msgtype)
            readings.append(scan_from_cloud(message))
            np.testing.assert_array_equal(readings[-1].scan.points, structured_points(message))
    first = readings[0]
    assert (len(readings), first.num_points, first.num_dropped_nan) == REAL_BAGS[bag]
    stamps = [reading.scan.stamp_ns for reading in readings]
    assert stamps == sorted(set(stamps))
    for reading in readings:
        assert len(reading.scan) == reading.num_points - reading.num_dropped_nan - reading.num_dropped_zero
        assert np.abs(reading.scan.points).max() < 500


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_120k_points_take_less_than_10_ms(flavour: str) -> None:
    points = np.random.default_rng(0).normal(size=(120_000, 3))
    points[::7] = np.nan
    message = xyz_cloud(points).message(flavour)
    durations = []
    for _ in range(7):
        start = time.process_time()
        reading = scan_from_cloud(message)
        durations.append(time.process_time() - start)
    assert reading.num_dropped_nan == len(points[::7])
    assert min(durations) < 0.010
