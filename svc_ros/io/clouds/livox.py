"""Livox' own message, livox_ros_driver2/CustomMsg, as the PointCloud2 that everything else reads."""

from __future__ import annotations

from dataclasses import dataclass

from svc_ros.io.clouds.cdr import CdrHeader, CdrReader
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE, CloudField

LIVOX_TYPE = "livox_ros_driver2/msg/CustomMsg"
CLOUD_TYPES = frozenset({CLOUD_TYPE, LIVOX_TYPE})  # that the node takes
NO_LIVOX_PACKAGE = (
    "its package is not found here: source the driver's workspace in this terminal, "
    "or set the driver's xfer_format to 0 (PointCloud2)"
)

# A point takes 19 bytes and begins at a multiple of four, so the last one lacks the filler of the others. Counted from
# the byte before the first point, all of them have 20, and nothing has to be copied.
_BEFORE, _STEP = 1, 20
_UINT8, _UINT32, _FLOAT32 = 2, 6, 7
_FIELDS = tuple(
    CloudField(name, _BEFORE + offset, datatype, 1)
    for name, offset, datatype in (
        ("offset_time", 0, _UINT32), ("x", 4, _FLOAT32), ("y", 8, _FLOAT32), ("z", 12, _FLOAT32),
        ("reflectivity", 16, _UINT8), ("tag", 17, _UINT8), ("line", 18, _UINT8),
    )
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class LivoxCloud:
    """The attributes of a PointCloud2; `data` looks into the message that it was read from."""

    header: CdrHeader
    width: int
    is_bigendian: bool
    data: memoryview
    height: int = 1
    fields: tuple[CloudField, ...] = _FIELDS
    point_step: int = _STEP
    row_step: int = 0  # a single row
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
    return LivoxCloud(header, num_points, reader.byte_order == ">", points)
