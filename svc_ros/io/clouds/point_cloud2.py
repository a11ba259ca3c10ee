"""sensor_msgs/PointCloud2 <-> core types, whoever made the message class.

The reader believes nothing that the bytes can contradict: a cloud is either read as its layout says, or refused with
what was expected and what was found. The writer gives plain values with which any message class can be filled.
"""

from __future__ import annotations

import operator
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError, UnsupportedCloudError
from svc_ros.core.scan import Array, Scan, frozen_array
from svc_ros.io.clouds.columns import CleanPoints, Column, clean_points, field_index
from svc_ros.io.clouds.free_space import free_directions
from svc_ros.io.clouds.point_times import TIME_FIELDS, offsets_from_stamp
from svc_ros.io.stamps import ns_from_stamp

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField
_FLOAT32 = 7


class CloudMessage(Protocol):
    """The attributes of sensor_msgs/PointCloud2 that are read: rosbags' classes and rclpy's have them all."""

    header: Any
    height: int
    width: int
    fields: Sequence[Any]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: Any


class CloudField(NamedTuple):
    """One sensor_msgs/PointField: offset in bytes from the point's start, datatype code 1 to 8, values a point."""

    name: str
    offset: int
    datatype: int
    count: int  # type: ignore[assignment]  # hides tuple.count, which nobody needs here


@dataclass(frozen=True, eq=False)
class CloudReading:
    """A cloud as a scan, and what did not become part of it.

    num_points: points in the message; num_dropped_nan: of those, dropped for a coordinate that is no number;
    num_dropped_zero: dropped for lying at exactly 0, 0, 0; num_out_of_range: dropped for lying at +inf, +inf, +inf,
    where the beam met nothing (`scan.free_directions` tells which way, in an organised cloud); time_field: the field
    that `scan.point_times_s` was read from, empty where the cloud tells no usable times.
    """

    scan: Scan
    num_points: int
    num_dropped_nan: int
    num_dropped_zero: int
    height: int
    width: int
    time_field: str = ""
    num_out_of_range: int = 0

    @property
    def nan_ratio(self) -> float:
        """Share of the message's points with a NaN or inf coordinate, in [0, 1]."""
        return (self.num_dropped_nan + self.num_out_of_range) / self.num_points if self.num_points else 0.0


@dataclass(frozen=True, eq=False)
class CloudLayout:
    """Everything that a PointCloud2 holds besides its header; `data` is of the type that rclpy takes unchecked."""

    fields: tuple[CloudField, ...]
    point_step: int
    row_step: int
    width: int
    height: int
    is_bigendian: bool
    is_dense: bool
    data: array[int]


@dataclass(frozen=True, eq=False)
class _Grid:
    """Where every value lies in the bytes; checked, so that a view of any field stays inside them."""

    fields: tuple[CloudField, ...]
    height: int
    width: int
    point_step: int
    row_step: int
    byte_order: str
    data: NDArray[np.uint8]

    def column(self, field: CloudField) -> Column:
        dtype = np.dtype(self.byte_order + _DTYPES[field.datatype])
        shape, strides = (self.height, self.width), (self.row_step, self.point_step)
        return np.ndarray(shape, dtype, self.data, field.offset, strides)

    def coordinate(self, name: str) -> Column:
        if not self.height * self.width:
            return np.empty(0)  # nothing can be misread, and an empty message often describes no fields
        field = self.fields[field_index([f.name for f in self.fields], name)]
        if not _is_scalar(field):
            raise UnsupportedCloudError(
                f"expected field '{name}' to be one number of datatype 1 to 8 a point, "
                f"found datatype {field.datatype}, count {field.count}"
            )
        return self.column(field)

    def time_fields(self) -> list[CloudField]:
        named = [[f for f in self.fields if f.name == name] for name in TIME_FIELDS]
        return [found[0] for found in named if len(found) == 1 and _is_scalar(found[0])]


def scan_from_cloud(msg: CloudMessage, *, sensor_origin: ArrayLike | None = None) -> CloudReading:
    """Read a PointCloud2; the message is not changed and the scan does not share its memory.

    sensor_origin: (3,) [m] where the sensor stood in the cloud's frame, the origin if not told. Coordinates of any
    PointField type are taken as metres; rows of an organised cloud follow each other. Points with NaN or inf (whatever
    `is_dense` claims) and points at exactly 0, 0, 0 are dropped together with their times, and counted. A cloud
    without points is an empty scan. In an organised cloud points at +inf, +inf, +inf tell the free directions; NaN and
    zero tell nothing. Of the fields TIME_FIELDS the first that holds one usable number a point tells the
    times (see `offsets_from_stamp` for units); others are left alone.

    Raises UnsupportedCloudError where layout and bytes contradict each other or x, y, z are not there exactly once,
    InputError where `sensor_origin` is no point.
    """
    stamp_ns, frame_id = ns_from_stamp(msg.header.stamp), str(msg.header.frame_id)
    origin = np.zeros(3) if sensor_origin is None else frozen_array(sensor_origin, np.float64, "sensor_origin", (3,))
    try:
        grid = _grid_from_message(msg)
        clean = clean_points([grid.coordinate(name) for name in "xyz"])
    except UnsupportedCloudError as error:
        raise UnsupportedCloudError(f"PointCloud2 in frame {frame_id!r:.80} at {stamp_ns} ns: {error}") from None
    time_field, times = _read_times(grid, clean.keep, stamp_ns)
    scan = Scan(clean.points, stamp_ns, frame_id, origin, times, _read_free(clean, origin, grid))
    num_points, num_beyond = grid.height * grid.width, int(clean.out_of_range.sum())
    return CloudReading(
        scan, num_points, clean.num_nan - num_beyond, clean.num_zero, grid.height, grid.width, time_field, num_beyond
    )  # fmt: skip


def cloud_layout(points: ArrayLike, columns: Mapping[str, ArrayLike] | None = None) -> CloudLayout:
    """Pack points (N, 3) [m] and optional columns (N,) by name as little-endian FLOAT32 in one row.

    NaN and inf are written as they are and clear `is_dense`. InputError for other shapes or a name used twice.
    """
    xyz = np.asarray(points)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise InputError(f"points: expected shape N x 3, found {xyz.shape}")
    extra = {name: np.asarray(values) for name, values in (columns or {}).items()}
    for name, values in extra.items():
        if name in ("x", "y", "z") or values.shape != (len(xyz),):
            raise InputError(f"column '{name}': expected shape ({len(xyz)},) and no coordinate, found {values.shape}")
    names = ["x", "y", "z", *extra]
    packed = np.empty((len(xyz), len(names)), "<f4")
    packed[:, :3] = xyz
    for i, values in enumerate(extra.values(), 3):
        packed[:, i] = values
    data = array("B")
    data.frombytes(packed.data.cast("B") if packed.size else b"")
    fields = tuple(CloudField(name, 4 * i, _FLOAT32, 1) for i, name in enumerate(names))
    step, dense = 4 * len(names), bool(np.isfinite(packed[:, :3]).all())
    return CloudLayout(fields, step, step * len(xyz), len(xyz), 1, False, dense, data)


def _is_scalar(field: CloudField) -> bool:
    return field.datatype in _DTYPES and field.count in (0, 1)  # some drivers leave count at 0


def _read_times(grid: _Grid, keep: NDArray[np.bool_], stamp_ns: int) -> tuple[str, Array | None]:
    for field in grid.time_fields() if keep.size else ():
        times = offsets_from_stamp(grid.column(field).reshape(-1)[keep], stamp_ns)
        if times is not None:
            return field.name, times
    return "", None


def _read_free(clean: CleanPoints, origin: Array, grid: _Grid) -> Array | None:
    if grid.height < 2 or not clean.out_of_range.any():
        return None
    relative = np.full((len(clean.keep), 3), np.nan)
    relative[clean.keep] = clean.points - origin
    return free_directions(relative, clean.out_of_range, grid.height, grid.width)


def _grid_from_message(msg: CloudMessage) -> _Grid:
    height, width, point_step = _whole(msg, "height"), _whole(msg, "width"), _whole(msg, "point_step")
    fields = tuple(
        CloudField(str(f.name), _whole(f, "offset"), _whole(f, "datatype"), _whole(f, "count")) for f in msg.fields
    )
    data = _bytes_of(msg.data)
    if height <= 0 or width <= 0:
        if height < 0 or width < 0 or data.size:
            raise UnsupportedCloudError(f"expected width x height to match {data.size} bytes, found {width} x {height}")
        return _Grid((), height, width, point_step, 0, "<", data)
    for field in fields:
        _check_inside(field, point_step)
    row_step = _checked_row_step(_whole(msg, "row_step"), height, width * point_step)
    needed = (height - 1) * row_step + width * point_step  # the last row needs no padding
    if data.size < needed:
        raise UnsupportedCloudError(
            f"truncated data: expected {needed} bytes for {width} x {height} points of {point_step} bytes in rows of "
            f"{row_step}, found {data.size}"
        )
    return _Grid(fields, height, width, point_step, row_step, ">" if msg.is_bigendian else "<", data)


def _whole(owner: Any, name: str) -> int:
    """An attribute that has to be a whole number, of whatever integer type."""
    value = getattr(owner, name)
    try:
        return operator.index(value)
    except TypeError:
        raise UnsupportedCloudError(f"expected {name} to be a whole number, found {value!r:.40}") from None


def _bytes_of(data: Any) -> NDArray[np.uint8]:
    try:
        return np.frombuffer(data, np.uint8) if memoryview(data).nbytes else np.empty(0, np.uint8)
    except (TypeError, ValueError, BufferError):
        raise UnsupportedCloudError(f"expected data to be one block of bytes, found {type(data).__name__}") from None


def _check_inside(field: CloudField, point_step: int) -> None:
    """Check other fields too: one that ends beyond the point shows that the step, hence every point, is wrong."""
    size = np.dtype(_DTYPES.get(field.datatype, "u1")).itemsize * max(field.count, 1)
    if field.offset < 0 or field.offset + size > point_step:
        raise UnsupportedCloudError(
            f"expected field {field.name!r:.80} inside point_step {point_step}, found bytes {field.offset} to "
            f"{field.offset + size}"
        )


def _checked_row_step(row_step: int, height: int, row_bytes: int) -> int:
    """Return the bytes from row to row: 0 means rows without padding, and a single row needs no step at all."""
    if row_step == 0 or height == 1:
        return row_bytes
    if row_step < row_bytes:
        raise UnsupportedCloudError(
            f"expected row_step of at least width x point_step = {row_bytes} bytes, found {row_step}"
        )
    return row_step
