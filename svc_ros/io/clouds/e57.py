"""E57 files of one scan, read by pye57."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import MissingDependencyError, UnsupportedCloudError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import apply, make_pose
from svc_ros.io.clouds.columns import RawPoints

_MAGIC = b"ASTM-E57"
_HEADER = struct.Struct("<8s8xQ")  # signature, then the version, then the length of the file
_CHUNK = 200_000  # points read at once, so that a header cannot ask for more memory than there is data
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")


def points_from_e57(path: Path) -> RawPoints:
    """Read the only scan of a file, in the file's common frame; where its pose puts the scanner is the sensor origin.

    Points that the scanner marks as invalid are dropped. UnsupportedCloudError for a broken file and one of none or
    several scans, MissingDependencyError without pye57.
    """
    _check_header(path)
    try:
        import pye57
    except ImportError:
        raise MissingDependencyError("E57 files need pye57: pip install pye57") from None
    try:
        with pye57.E57(str(path)) as file:
            if file.scan_count != 1:
                raise UnsupportedCloudError(
                    f"expected one scan, found {file.scan_count}, each with a place of its own; save each as a file"
                )
            return _read_scan(file, path.stat().st_size)
    except UnsupportedCloudError:
        raise
    except Exception as error:  # on broken bytes pye57 raises errors of many unrelated kinds
        told = " ".join(str(error).split()).partition(" ****")[0]
        raise UnsupportedCloudError(f"not a readable E57 file, or truncated: {told:.160}") from None


def _check_header(path: Path) -> None:
    with path.open("rb") as stream:
        head = stream.read(_HEADER.size)
    if len(head) < _HEADER.size or not head.startswith(_MAGIC):
        raise UnsupportedCloudError("expected an E57 header, found none")
    expected, found = _HEADER.unpack(head)[1], path.stat().st_size
    if found != expected:
        raise UnsupportedCloudError(f"truncated, or damaged: expected {expected} bytes, found {found}")


def _read_scan(file: Any, num_bytes: int) -> RawPoints:
    header = file.get_header(0)
    stored = set(header.point_fields)
    names = next((names for names in (_CARTESIAN, _SPHERICAL) if stored.issuperset(names)), None)
    if names is None:
        raise UnsupportedCloudError(f"expected {', '.join(_CARTESIAN)}, found {', '.join(sorted(stored)):.160}")
    if header.point_count > 8 * num_bytes:  # constant columns take no bytes, however many points there are
        raise UnsupportedCloudError(f"expected a point a bit at most, found {header.point_count} in {num_bytes} bytes")
    state = "cartesianInvalidState" if names is _CARTESIAN else "sphericalInvalidState"
    columns = _read_columns(file, header, [*names, *([state] if state in stored else [])])
    points = _from_spherical(columns[:3]) if names is _SPHERICAL else columns[:3]
    points[:, (columns[3:] != 0).any(axis=0)] = np.nan
    if not header.has_pose():
        return RawPoints(list(points))
    x, y, z = (float(value) for value in header.translation)
    pose = make_pose(Rotation.from_quat(np.roll(header.rotation, -1)).as_matrix(), (x, y, z))  # stored as w x y z
    return RawPoints(list(apply(pose, points.T).T), (x, y, z))


def _read_columns(file: Any, header: Any, names: list[str]) -> Array:
    """(len(names), N)"""
    arrays, buffers = file.make_buffers(names, _CHUNK)
    reader = header.points.reader(buffers)
    chunks: list[Array] = [np.empty((len(names), 0))]
    while count := reader.read():
        chunks.append(np.stack([arrays[name][:count].astype(np.float64) for name in names]))
    return np.concatenate(chunks, axis=1)


def _from_spherical(columns: Array) -> Array:
    """Range [m], azimuth and elevation [rad] as x, y, z [m], (3, N)."""
    distance, azimuth, elevation = columns
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)])
