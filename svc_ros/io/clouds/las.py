"""LAS and LAZ files, read by laspy behind a check of the sizes that the header declares."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from svc_ros.core.errors import MissingDependencyError, UnsupportedCloudError
from svc_ros.core.scan import Array
from svc_ros.io.clouds.columns import RawPoints

_CHUNK = 1_000_000  # points read at once, so that a header cannot ask for more memory than there is data
_SIZES = struct.Struct("<HIIBH")  # header bytes, start of the points, number of VLRs, point format, bytes a point
_SIZES_OFFSET = 94
_NUM_EVLRS_OFFSET = 243  # present from LAS 1.4 on, whose header has 375 bytes
_VLR_BYTES, _EVLR_BYTES = 54, 60
_COMPRESSED = 0x80
_LAZ_RECORD, _LAZ_RECORD_START = b"laszip encoded\0\0", 52  # bytes from the name to what it is the name of
_LAZ_RECORD_SIZES = struct.Struct("<12xI16xH")  # points a chunk, number of items; then type, bytes, version of each
_MOST_POINT_BYTES = 4096  # a format has 67 at most, and what a writer adds hardly more than these
_CHUNKS_OF_ANY_SIZE = 0xFFFFFFFF
_SMALLEST_CHUNK = 20  # bytes: its first point is stored as it is


def points_from_las(data: bytes) -> RawPoints:
    """Parse the bytes of a LAS or LAZ file; coordinates as stored, scale and offset applied.

    UnsupportedCloudError for a broken or truncated file, MissingDependencyError without laspy, or without a backend
    of it for a compressed file.
    """
    try:
        import laspy
    except ImportError:
        raise MissingDependencyError("LAS files need laspy: pip install 'laspy[lazrs]'") from None
    if _check_header(data) and not laspy.LazBackend.detect_available():
        raise MissingDependencyError("compressed LAZ files need a backend of laspy: pip install 'laspy[lazrs]'")
    try:
        with laspy.open(io.BytesIO(data)) as reader:
            return RawPoints(list(_read_columns(reader)))
    except UnsupportedCloudError:
        raise
    except BaseException as error:  # on broken bytes laspy and its backends raise errors of many unrelated kinds
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":  # of a backend in Rust
            raise
        raise UnsupportedCloudError(f"not a readable LAS file, or truncated: {error!s:.160}") from None


def _check_header(data: bytes) -> bool:
    """Return whether the points are compressed; refuse what laspy would spend minutes or all memory on."""
    if len(data) < _SIZES_OFFSET + _SIZES.size or not data.startswith(b"LASF"):
        raise UnsupportedCloudError(f"expected a LAS header, found none in {len(data)} bytes")
    header_bytes, start, num_vlrs, point_format, _ = _SIZES.unpack_from(data, _SIZES_OFFSET)
    if not header_bytes + num_vlrs * _VLR_BYTES <= start <= len(data):
        raise UnsupportedCloudError(
            f"expected points after {header_bytes} bytes of header and {num_vlrs} records, within {len(data)} bytes, "
            f"found them declared at {start}"
        )
    if data[25] >= 4 and len(data) >= _NUM_EVLRS_OFFSET + 4:
        (num_evlrs,) = struct.unpack_from("<I", data, _NUM_EVLRS_OFFSET)
        if num_evlrs * _EVLR_BYTES > len(data):
            raise UnsupportedCloudError(f"expected {num_evlrs} extended records, found {len(data)} bytes in all")
    if point_format & _COMPRESSED:
        _check_compression(data[:start], len(data))
        _check_chunk_table(data, start)
    return bool(point_format & _COMPRESSED)


def _check_compression(header: bytes, num_bytes: int) -> None:
    """Refuse chunks and points of sizes that there cannot be: the decompressor takes memory for a whole one of each."""
    record = header[header.find(_LAZ_RECORD) + _LAZ_RECORD_START :] if _LAZ_RECORD in header else b""
    if len(record) < _LAZ_RECORD_SIZES.size:
        return  # which laspy refuses
    size, num_items = _LAZ_RECORD_SIZES.unpack_from(record)
    if size != _CHUNKS_OF_ANY_SIZE and size > max(num_bytes, _CHUNK):
        raise UnsupportedCloudError(f"expected LAZ chunks within {num_bytes} bytes, found chunks of {size} points")
    at = _LAZ_RECORD_SIZES.size
    items = np.frombuffer(record, "<u2", min(3 * num_items, (len(record) - at) // 2), at)
    if items[1::3].sum() > _MOST_POINT_BYTES:
        raise UnsupportedCloudError(
            f"expected LAZ points of at most {_MOST_POINT_BYTES} bytes, found {items[1::3].sum()}"
        )


def _check_chunk_table(data: bytes, start: int) -> None:
    """Refuse a chunk table that is cut off or longer than the file: the decompressor would end the whole process."""
    places = [start, len(data) - 8]  # a writer that cannot seek puts the table's offset at the end
    offsets = [struct.unpack_from("<q", data, place)[0] for place in places if 0 <= place <= len(data) - 8]
    offset = next((offset for offset in offsets if offset != -1), -1)
    if not start <= offset <= len(data) - 8:
        raise UnsupportedCloudError(f"truncated: expected LAZ chunk table at byte {offset}, found {len(data)} bytes")
    (num_chunks,) = struct.unpack_from("<I", data, offset + 4)
    if num_chunks * _SMALLEST_CHUNK > len(data):
        raise UnsupportedCloudError(f"expected {num_chunks} LAZ chunks, found {len(data)} bytes in all")


def _read_columns(reader: Any) -> Array:
    count, done = reader.header.point_count, 0
    chunks: list[Array] = [np.empty((3, 0))]
    while done < count:
        points = reader.read_points(min(_CHUNK, count - done))
        if not len(points):
            raise UnsupportedCloudError(f"truncated: expected {count} points, found {done}")
        chunks.append(np.stack([np.asarray(c, np.float64) for c in (points.x, points.y, points.z)]))
        done += len(points)
    return np.concatenate(chunks, axis=1)
