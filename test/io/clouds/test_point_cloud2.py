"""The PointCloud2 reader against every way in which a cloud can be laid out, or broken."""

from __future__ import annotations

import copy
from array import array
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cloud_messages import CODES, FLAVOURS, FLOAT64, Cloud, Column, Field, Layout, pack, xyz_cloud, xyz_columns

from svc_ros.core.errors import InputError, UnsupportedCloudError
from svc_ros.io.clouds.point_cloud2 import CloudReading, cloud_layout, scan_from_cloud

POINTS = [[1.0, 2.0, 3.0], [-4.0, 5.5, 6.25], [7.0, -8.0, 9.0], [10.0, 11.0, -12.0], [0.5, 0.0, 0.0], [0.0, 0.0, -2.0]]
STAMP_NS = 1_500_000_000_250_000_000
Read = Callable[[Cloud], CloudReading]


@pytest.fixture(params=FLAVOURS)
def read(request: pytest.FixtureRequest) -> Read:
    return lambda cloud: scan_from_cloud(cloud.message(request.param))


def assert_points(reading: CloudReading, expected: Any = POINTS) -> None:
    np.testing.assert_array_equal(reading.scan.points, np.asarray(expected, float).reshape(-1, 3))


# What can be read


def test_plain_cloud_with_stamp_and_frame(read: Read) -> None:
    reading = read(pack(xyz_columns(POINTS)))
    assert_points(reading)
    assert (reading.scan.stamp_ns, reading.scan.frame_id) == (STAMP_NS, "lidar")
    assert (reading.num_points, reading.height, reading.width) == (6, 1, 6)
    assert (reading.num_dropped_nan, reading.num_dropped_zero, reading.nan_ratio) == (0, 0, 0.0)
    assert reading.scan.point_times_s is None
    assert reading.time_field == ""


def test_sensor_origin_is_passed_on() -> None:
    reading = scan_from_cloud(pack(xyz_columns(POINTS)).message(), sensor_origin=[0.1, 0.2, 1.5])
    np.testing.assert_array_equal(reading.scan.sensor_origin, [0.1, 0.2, 1.5])


@pytest.mark.parametrize("data_type", [bytes, bytearray, memoryview, lambda b: array("B", b)])
def test_data_as_any_block_of_bytes(data_type: Callable[[bytes], Any]) -> None:
    message = pack(xyz_columns(POINTS)).message()
    message.data = data_type(bytes(message.data))
    assert_points(scan_from_cloud(message))


def test_padding_within_points(read: Read) -> None:
    assert_points(read(pack(xyz_columns(POINTS), Layout(point_step=32))))


def test_organised_cloud_with_padded_rows(read: Read) -> None:
    reading = read(pack(xyz_columns(POINTS), Layout(height=2, row_step=50)))
    assert_points(reading)
    assert (reading.num_points, reading.height, reading.width) == (6, 2, 3)


def test_last_row_may_lack_its_padding(read: Read) -> None:
    cloud = pack(xyz_columns(POINTS), Layout(height=2, row_step=50))
    assert_points(read(replace(cloud, data=cloud.data[: 50 + 36])))


def test_row_step_zero_means_rows_without_padding(read: Read) -> None:
    assert_points(read(replace(pack(xyz_columns(POINTS), Layout(height=2)), row_step=0)))


@pytest.mark.parametrize("row_step", [1, 12, 10_000])
def test_row_step_of_a_single_row_does_not_matter(read: Read, row_step: int) -> None:
    assert_points(read(replace(pack(xyz_columns(POINTS)), row_step=row_step)))


def test_more_data_than_needed(read: Read) -> None:
    cloud = pack(xyz_columns(POINTS))
    assert_points(read(replace(cloud, data=cloud.data + b"tail")))


@pytest.mark.parametrize("datatype", sorted(CODES))
def test_every_number_type(read: Read, datatype: int) -> None:
    points = [[1, 2, 3], [100, 0, 7]]
    assert_points(read(pack(xyz_columns(points, datatype))), points)


def test_double_precision_is_kept(read: Read) -> None:
    points = [[4_500_000.123456, 0.1, 1e-9]]
    assert_points(read(pack(xyz_columns(points, FLOAT64))), points)


def test_mixed_number_types(read: Read) -> None:
    values = np.array([[1.0, 2.5, 3.0], [4.0, 0.1, -6.0]])
    columns = [Column("x", [1.0, 4.0]), Column("y", [2.5, 0.1], FLOAT64), Column("z", [3, -6], 3)]
    assert_points(read(pack(columns)), values)


@pytest.mark.parametrize("datatype", [3, 5, 7, 8])
def test_big_endian_is_read_and_left_alone(read: Read, datatype: int) -> None:
    cloud = pack(xyz_columns([[1, -2, 300], [4, 5, 6]], datatype), Layout(bigendian=True))
    assert_points(read(cloud), [[1, -2, 300], [4, 5, 6]])


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("bigendian", [False, True])
def test_message_is_not_changed_nor_shared(flavour: str, bigendian: bool) -> None:
    cloud = pack(xyz_columns([*POINTS, [np.nan, 0, 0]], FLOAT64), Layout(bigendian=bigendian))
    message = cloud.message(flavour)
    before = copy.deepcopy(message)
    scan = scan_from_cloud(message).scan
    assert bytes(message.data) == bytes(before.data) == cloud.data
    assert (message.is_bigendian, message.is_dense) == (before.is_bigendian, before.is_dense)
    assert not np.shares_memory(scan.points, np.frombuffer(message.data, np.uint8))


def test_unaligned_offsets(read: Read) -> None:
    columns = [replace(c, offset=o) for c, o in zip(xyz_columns(POINTS), (1, 7, 18), strict=True)]
    assert_points(read(pack(columns, Layout(point_step=23, height=3, row_step=53))))


def test_any_field_order_and_other_fields(read: Read) -> None:
    x, y, z = xyz_columns(POINTS)
    other = [Column("ring", range(6), 4), Column("intensity", [9.0] * 6)]
    assert_points(read(pack([other[0], z, y, other[1], x])))


def test_count_zero_is_read_as_one(read: Read) -> None:
    assert_points(read(pack([replace(c, count=0) for c in xyz_columns(POINTS)])))


def test_other_fields_may_hold_several_values_or_unknown_types(read: Read) -> None:
    cloud = pack(xyz_columns(POINTS), Layout(point_step=24))
    strange = (Field("descriptor", 12, 7, 2), Field("flags", 20, 77), Field("flags", 21, 0))
    assert_points(read(replace(cloud, fields=(*cloud.fields, *strange))))


# What is dropped, and counted


@pytest.mark.parametrize("is_dense", [True, False])
def test_nan_and_inf_are_dropped_whatever_is_dense_says(read: Read, is_dense: bool) -> None:
    broken = [[np.nan, 1, 1], [1, np.inf, 1], [1, 1, -np.inf], [np.nan] * 3]
    reading = read(pack(xyz_columns(broken[:2] + POINTS + broken[2:]), Layout(extra={"is_dense": is_dense})))
    assert_points(reading)
    assert (reading.num_points, reading.num_dropped_nan, reading.num_dropped_zero) == (10, 4, 0)
    assert reading.nan_ratio == 0.4


def test_points_at_zero_are_dropped_and_counted_apart(read: Read) -> None:
    reading = read(pack(xyz_columns([[0, 0, 0], *POINTS, [-0.0, 0, -0.0], [np.nan] * 3])))
    assert_points(reading)
    assert (reading.num_points, reading.num_dropped_nan, reading.num_dropped_zero) == (9, 1, 2)


def test_cloud_of_nothing_usable_is_an_empty_scan(read: Read) -> None:
    reading = read(pack([*xyz_columns([[np.nan] * 3, [0, 0, 0]]), Column("t", [1, 2], 6)]))
    assert len(reading.scan) == 0
    assert (reading.num_points, reading.num_dropped_nan, reading.num_dropped_zero) == (2, 1, 1)


@pytest.mark.parametrize(("width", "height"), [(0, 1), (0, 0), (5, 0)])
def test_zero_points(read: Read, width: int, height: int) -> None:
    reading = read(replace(xyz_cloud(np.empty((0, 3))), width=width, height=height))
    assert (len(reading.scan), reading.num_points, reading.nan_ratio) == (0, 0, 0.0)


def test_message_that_was_never_filled(read: Read) -> None:
    assert len(read(Cloud((), b"", 0, 0, 0, 0)).scan) == 0


# Times


@pytest.mark.parametrize("name", ["t", "time", "timestamp", "offset_time", "time_stamp"])
def test_integer_times_are_nanoseconds(read: Read, name: str) -> None:
    reading = read(pack([*xyz_columns(POINTS[:3]), Column(name, [0, 50_000_000, 99_999_999], 6)]))
    np.testing.assert_allclose(reading.scan.point_times_s, [0, 0.05, 0.099999999], rtol=1e-15)
    assert reading.time_field == name


@pytest.mark.parametrize("datatype", [7, 8])
def test_float_times_are_seconds(read: Read, datatype: int) -> None:
    reading = read(pack([*xyz_columns(POINTS[:3]), Column("time", [-0.05, 0.0, 0.1], datatype)]))
    np.testing.assert_allclose(reading.scan.point_times_s, [-0.05, 0.0, 0.1], rtol=1e-7)


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 1e-6), (1e9, 1e-6)])
def test_absolute_times_become_relative_to_the_stamp(read: Read, scale: float, tolerance: float) -> None:
    offsets = np.array([-0.1, 0.0, 0.1])
    stamps = ((1_500_000_000.25 + offsets) * scale).tolist()
    reading = read(pack([*xyz_columns(POINTS[:3]), Column("timestamp", stamps, FLOAT64)]))
    np.testing.assert_allclose(reading.scan.point_times_s, offsets, atol=tolerance)


def test_times_are_filtered_together_with_the_points(read: Read) -> None:
    points = [[np.nan] * 3, POINTS[0], [0, 0, 0], POINTS[1]]
    reading = read(pack([*xyz_columns(points), Column("time", [np.nan, 0.25, 0.5, 0.75])]))
    assert_points(reading, POINTS[:2])
    np.testing.assert_array_equal(reading.scan.point_times_s, [0.25, 0.75])


@pytest.mark.parametrize("values", [[5.0, 5.1], [0.1, np.nan], [1e300, 0.0]])
def test_times_of_another_clock_are_not_believed(read: Read, values: list[float]) -> None:
    reading = read(pack([*xyz_columns(POINTS[:2]), Column("timestamp", values, FLOAT64)]))
    assert_points(reading, POINTS[:2])
    assert reading.scan.point_times_s is None
    assert reading.time_field == ""


def test_usable_times_are_preferred_over_unusable_ones(read: Read) -> None:
    columns = [Column("time", [1e8, 1e8]), Column("offset_time", [0, 1000], 6)]
    reading = read(pack([*xyz_columns(POINTS[:2]), *columns]))
    np.testing.assert_allclose(reading.scan.point_times_s, [0, 1e-6])
    assert reading.time_field == "offset_time"


@pytest.mark.parametrize(
    "fields", [[Field("t", 12, 6, 2)], [Field("t", 12, 6), Field("t", 16, 6)], [Field("t", 12, 9)]]
)
def test_time_field_that_is_not_one_number_is_left_alone(read: Read, fields: list[Field]) -> None:
    cloud = pack(xyz_columns(POINTS), Layout(point_step=20))
    assert read(replace(cloud, fields=(*cloud.fields, *fields))).scan.point_times_s is None


# What is refused: each message names what was expected and what was found


def assert_refused(read: Read, cloud: Cloud, *parts: str) -> None:
    with pytest.raises(UnsupportedCloudError) as caught:
        read(cloud)
    message = str(caught.value)
    assert "expected" in message
    assert "found" in message
    assert "\n" not in message
    for part in (*parts, "'lidar'"):
        assert part in message


@pytest.mark.parametrize("missing", ["x", "y", "z"])
def test_missing_coordinate(read: Read, missing: str) -> None:
    cloud = pack([replace(c, name="range") if c.name == missing else c for c in xyz_columns(POINTS)])
    assert_refused(read, cloud, f"'{missing}'", "found 0", "range")


def test_no_fields_at_all(read: Read) -> None:
    assert_refused(read, replace(pack(xyz_columns(POINTS)), fields=()), "'x'", "no fields at all")


@pytest.mark.parametrize("twice", ["x", "y", "z"])
def test_duplicate_coordinate(read: Read, twice: str) -> None:
    cloud = pack([*xyz_columns(POINTS), Column(twice, [0.0] * 6)])
    assert_refused(read, cloud, f"'{twice}'", "found 2")


def test_coordinate_of_several_values(read: Read) -> None:
    x, y, z = xyz_columns(POINTS)
    assert_refused(read, pack([x, y, replace(z, count=3)], Layout(point_step=32)), "'z'", "count 3")


@pytest.mark.parametrize("datatype", [0, 9, 255])
def test_coordinate_of_unknown_type(read: Read, datatype: int) -> None:
    cloud = pack(xyz_columns(POINTS))
    fields = (replace(cloud.fields[0], datatype=datatype), *cloud.fields[1:])
    assert_refused(read, replace(cloud, fields=fields), "'x'", f"datatype {datatype}")


@pytest.mark.parametrize("field", [Field("z", 9), Field("z", 8, FLOAT64), Field("z", 2**32 - 1)])
def test_coordinate_beyond_the_point(read: Read, field: Field) -> None:
    cloud = pack(xyz_columns(POINTS))
    assert_refused(read, replace(cloud, fields=(*cloud.fields[:2], field)), "'z'", "point_step 12", str(field.offset))


def test_other_field_beyond_the_point_shows_a_wrong_point_step(read: Read) -> None:
    cloud = pack([*xyz_columns(POINTS), Column("intensity", [1.0] * 6)])
    assert_refused(read, replace(cloud, point_step=12, row_step=72), "'intensity'", "point_step 12", "12 to 16")


def test_point_step_zero(read: Read) -> None:
    assert_refused(read, replace(pack(xyz_columns(POINTS)), point_step=0), "point_step 0")


@pytest.mark.parametrize("missing", [1, 12, 71, 72])
def test_truncated_data(read: Read, missing: int) -> None:
    cloud = pack(xyz_columns(POINTS))
    assert_refused(read, replace(cloud, data=cloud.data[:-missing]), "truncated", "72", f"found {72 - missing}")


def test_truncated_organised_data_counts_row_padding(read: Read) -> None:
    cloud = pack(xyz_columns(POINTS), Layout(height=2, row_step=50))
    assert_refused(read, replace(cloud, data=cloud.data[:85]), "truncated", "86", "found 85")


def test_row_step_shorter_than_a_row(read: Read) -> None:
    cloud = replace(pack(xyz_columns(POINTS), Layout(height=2)), row_step=35)
    assert_refused(read, cloud, "row_step", "36", "found 35")


@pytest.mark.parametrize(("width", "height"), [(7, 1), (6, 2), (2**32 - 1, 2**32 - 1)])
def test_size_beyond_the_data(read: Read, width: int, height: int) -> None:
    cloud = replace(pack(xyz_columns(POINTS)), width=width, height=height, row_step=0)
    assert_refused(read, cloud, "truncated", f"{width} x {height}", "found 72")


@pytest.mark.parametrize(("width", "height"), [(6, 0), (0, 1)])
def test_no_points_but_data(read: Read, width: int, height: int) -> None:
    cloud = replace(pack(xyz_columns(POINTS)), width=width, height=height)
    assert_refused(read, cloud, "72 bytes", f"{width} x {height}")


@pytest.mark.parametrize("data", [[0] * 72, "text", None, np.zeros(144, np.uint8)[::2]])
def test_data_that_is_no_block_of_bytes(data: Any) -> None:
    message = pack(xyz_columns(POINTS)).message()
    message.data = data
    with pytest.raises(UnsupportedCloudError, match="expected data to be one block of bytes, found"):
        scan_from_cloud(message)


# Writing


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_written_cloud_reads_back(flavour: str) -> None:
    points = np.random.default_rng(1).normal(size=(50, 3)).astype(np.float32)
    layout = cloud_layout(points, {"time": np.linspace(0, 0.1, 50), "intensity": np.arange(50)})
    assert [f.name for f in layout.fields] == ["x", "y", "z", "time", "intensity"]
    assert (layout.point_step, layout.row_step, layout.width, layout.height) == (20, 1000, 50, 1)
    assert (layout.is_dense, layout.is_bigendian, type(layout.data)) == (True, False, array)
    sizes = {k: getattr(layout, k) for k in ("point_step", "row_step", "width", "height", "is_bigendian", "is_dense")}
    cloud = Cloud(tuple(Field(*f) for f in layout.fields), layout.data.tobytes(), **sizes)
    reading = scan_from_cloud(cloud.message(flavour))
    np.testing.assert_array_equal(reading.scan.points, points.astype(float))
    np.testing.assert_allclose(reading.scan.point_times_s, np.linspace(0, 0.1, 50), atol=1e-8)


def test_written_empty_cloud_has_all_fields() -> None:
    layout = cloud_layout(np.empty((0, 3)))
    assert ([f.name for f in layout.fields], layout.width, len(layout.data)) == (["x", "y", "z"], 0, 0)


def test_written_nan_clears_is_dense() -> None:
    assert not cloud_layout([[1.0, np.nan, 0.0]]).is_dense


@pytest.mark.parametrize(
    ("points", "columns"),
    [(np.zeros((2, 4)), None), (np.zeros(3), None), (np.zeros((2, 3)), {"i": [1.0]}), (np.zeros((1, 3)), {"x": [1.0]})],
)
def test_other_shapes_are_not_written(points: Any, columns: Any) -> None:
    with pytest.raises(InputError, match="expected shape"):
        cloud_layout(points, columns)
