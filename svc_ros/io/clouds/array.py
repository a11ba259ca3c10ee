"""Scans in files of bare numbers (.bin) and in NumPy files."""

from __future__ import annotations

import io
import math
import zipfile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.columns import RawPoints, xyz_places
from svc_ros.io.clouds.columns_guess import NAME_THEM, contradicts, guess_layout
from svc_ros.io.clouds.layout import NUSCENES, Layout
from svc_ros.io.npy_header import read_npy_header

_MOST_COLUMNS = 16  # more columns than this is an array of something else, or transposed
_DEFLATE_EXPANSION = 1032  # most bytes that one compressed byte can stand for


def points_from_bin(data: bytes, layout: Layout | None) -> RawPoints:
    """Parse points without a header, little-endian; layout: their columns, None: those that the numbers tell.

    UnsupportedCloudError where the bytes are no whole number of points, or the numbers tell no columns or others.
    """
    other = contradicts(data, layout) if layout else None
    if other:
        raise UnsupportedCloudError(
            f"expected columns {layout}, as --columns or the name .pcd.bin says, found numbers of {other}; {NAME_THEM}"
        )
    layout = layout or guess_layout(data)
    if len(data) % layout.point_bytes or not data:
        raise UnsupportedCloudError(
            f"truncated, or other columns than {layout}: expected a multiple of {layout.point_bytes} bytes, found "
            f"{len(data)}"
        )
    values = np.frombuffer(data, layout.dtype).reshape(-1, len(layout.names))
    return RawPoints(list(values[:, layout.xyz].T))


def points_from_nuscenes(data: bytes, layout: Layout | None) -> RawPoints:
    """The same for nuScenes' files, whose columns their name tells."""
    return points_from_bin(data, layout or NUSCENES)


def points_from_npy(data: bytes) -> RawPoints:
    """Parse one saved array: (N, 3) or wider, whose first columns are x, y, z [m], or a structured one with x, y, z."""
    return _columns_of(_read_array(io.BytesIO(data), len(data)))


def points_from_npz(data: bytes) -> RawPoints:
    """Parse an archive of arrays: the one named `points`, else the only one there is."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            if "points.npy" not in names and len(names) != 1:
                listed = ", ".join(name.removesuffix(".npy") for name in names)
                raise UnsupportedCloudError(f"expected an array 'points' or a single one, found: {listed:.200}")
            info = archive.getinfo("points.npy" if "points.npy" in names else names[0])
            with archive.open(info) as member:
                size = min(info.file_size, _DEFLATE_EXPANSION * info.compress_size)
                return _columns_of(_read_array(member, size))
    except UnsupportedCloudError:
        raise
    except Exception as error:  # on broken bytes zipfile and zlib raise errors of many unrelated kinds
        raise UnsupportedCloudError(f"not a readable npz archive: {error}") from None


def _read_array(stream: IO[bytes], num_bytes: int) -> NDArray[Any]:
    """Read one .npy stream of `num_bytes`; the size that its header declares is compared before memory is taken."""
    try:
        shape, fortran_order, dtype = read_npy_header(stream)
    except ValueError as error:
        raise UnsupportedCloudError(f"not a saved NumPy array: {error!s:.160}") from None
    if dtype.hasobject:
        raise UnsupportedCloudError("expected an array of numbers, found Python objects (pickles are never loaded)")
    needed = math.prod(shape) * dtype.itemsize
    data = stream.read(needed) if needed <= num_bytes else b""
    if len(data) < needed:
        raise UnsupportedCloudError(f"truncated: expected {needed} bytes for shape {shape}, found fewer")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran_order else "C") if data else np.empty((0, 3))


def _columns_of(array: NDArray[Any]) -> RawPoints:
    if array.dtype.names is not None and array.ndim == 1:
        names = list(array.dtype.names)
        columns = [array[names[place]] for place in xyz_places(names)]
    elif array.ndim == 2 and 3 <= array.shape[1] <= _MOST_COLUMNS:
        columns = list(array[:, :3].T)
    else:
        raise UnsupportedCloudError(f"expected shape N x 3 (up to N x {_MOST_COLUMNS}), found {array.shape}")
    if any(column.dtype.kind not in "iuf" or column.size != len(array) for column in columns):
        raise UnsupportedCloudError(f"expected one real number a coordinate, found type {array.dtype}")
    return RawPoints(columns)
