"""Livox' own message, CustomMsg of both of its drivers, as the PointCloud2 that everything else reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.io.clouds.cdr import CdrReader
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, CloudField

LIVOX_TYPE = "livox_ros_driver2/msg/CustomMsg"
CLOUD_TYPES = frozenset({CLOUD_TYPE, LIVOX_TYPE})  # that the node takes
LIVOX_TYPES = frozenset({LIVOX_TYPE, "livox_ros_driver/msg/CustomMsg"})  # that bags have
NO_LIVOX_PACKAGE = (
    "its package is not found here: source the driver's workspace in this terminal, "
    "or set the driver's xfer_format to 0 (PointCloud2)"
)

# A point takes 19 bytes and begins at a multiple of four, so the last one lacks the filler of the others. Counted from
# the byte before the first point, all of them have 20, and nothing has to be copied.
_BEFORE, _STEP = 1, 20
_UINT8, _UINT32, _FLOAT32, _FLOAT64 = 2, 6, 7, 8
LIVOX_DEFINITIONS = {  # of every type of the drivers, where a bag has none
    f"{package}/msg/{name}": text.format(package=package)
    for package in sorted(kind.partition("/")[0] for kind in LIVOX_TYPES)
    for name, text in (
        (
            "CustomPoint",
            "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n",
        ),
        (
            "CustomMsg",
            "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
            "{package}/CustomPoint[] points\n",
        ),
    )
}
_FIELDS = tuple(
    CloudField(name, _BEFORE + offset, datatype, 1)
    for name, offset, datatype in (
        ("offset_time", 0, _UINT32), ("x", 4, _FLOAT32), ("y", 8, _FLOAT32), ("z", 12, _FLOAT32),
        ("reflectivity", 16, _UINT8), ("tag", 17, _UINT8), ("line", 18, _UINT8),
    )
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LivoxCloud:
    """The attributes of a PointCloud2; `data` looks into the message that it was read from, where it can."""

    header: Any
    width: int
    is_bigendian: bool
    data: memoryview | NDArray[np.uint8]
    height: int = 1
    fields: tuple[CloudField, ...] = _FIELDS
    point_step: int = _STEP
    row_step: int = 0
    is_dense: bool = False


def cloud_from_cdr(data: bytes) -> LivoxCloud:
    """A serialised CustomMsg as a cloud whose points were measured `offset_time` [ns] after the header's stamp.

    The driver stamps the header with `timebase`, from which `offset_time` counts. How many points there are, the list
    of points tells; `scan_from_cloud` refuses a list that is shorter than it says. Raises UnsupportedCloudError where
    not even stamp and frame can be read.
    """
    reader = CdrReader(data)
    header = reader.header()
    for code in ("Q", "I", "B", "B", "B", "B"):  # timebase, point_num, lidar_id, rsvd
        reader.value(code)
    num_points = reader.value("I")
    points = memoryview(data)[reader.position - _BEFORE :] if num_points else memoryview(b"")
    return LivoxCloud(header, num_points, reader.byte_order == ">", points, row_step=_STEP * num_points)


def cloud_from_points(message: Any) -> LivoxCloud:
    """A CustomMsg of other fields than the driver's, an object a point: all that are numbers, by their names."""
    points = message.points
    names = [name for name, value in vars(points[0]).items() if isinstance(value, int | float)] if len(points) else []
    columns = {name: np.array([getattr(point, name) for point in points]) for name in names}
    kinds = {name: (_UINT32, "<u4") if _is_whole(column) else (_FLOAT64, "<f8") for name, column in columns.items()}
    rows = np.empty(len(points), np.dtype([(name, code) for name, (_, code) in kinds.items()]))
    fields, step = [], 0
    for name, (datatype, code) in kinds.items():
        rows[name] = columns[name]
        fields.append(CloudField(name, step, datatype, 1))
        step += np.dtype(code).itemsize
    data = np.frombuffer(rows.tobytes(), np.uint8)
    return LivoxCloud(message.header, len(rows), False, data, 1, tuple(fields), step, step * len(rows))


def _is_whole(column: NDArray[Any]) -> bool:
    """Whether times may be among these numbers: those have to stay whole, to be read as nanoseconds."""
    return column.dtype.kind in "iu" and int(column.min()) >= 0 and int(column.max()) < 2**32
