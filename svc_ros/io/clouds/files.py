"""One scan from one file, whatever its format."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from svc_ros.core.errors import InputError, MissingDependencyError, UnsupportedCloudError
from svc_ros.core.scan import Scan
from svc_ros.io.clouds.array import points_from_bin, points_from_npy, points_from_npz, points_from_nuscenes
from svc_ros.io.clouds.columns import RawPoints, clean_points
from svc_ros.io.clouds.e57 import points_from_e57
from svc_ros.io.clouds.las import points_from_las
from svc_ros.io.clouds.layout import Layout, read_layout
from svc_ros.io.clouds.pcd import points_from_pcd, write_pcd
from svc_ros.io.clouds.ply import points_from_ply
from svc_ros.io.clouds.text import points_from_text

__all__ = ["SUFFIXES", "read_scan", "write_pcd"]

# Of bare numbers, whose columns may be named from outside.
_COLUMN_PARSERS = {".bin": points_from_bin, ".pcd.bin": points_from_nuscenes} | dict.fromkeys(
    (".xyz", ".txt", ".asc", ".csv", ".pts"), points_from_text
)
_PARSERS = {
    ".pcd": points_from_pcd,
    ".ply": points_from_ply,
    ".npy": points_from_npy,
    ".npz": points_from_npz,
    ".las": points_from_las,
    ".laz": points_from_las,
}
SUFFIXES = (*_COLUMN_PARSERS, *_PARSERS, ".e57")


def read_scan(path: str | os.PathLike[str], columns: str = "") -> Scan:
    """Read the points [m] of a file in its own frame; NaN, inf and points at exactly 0, 0, 0 are dropped.

    Formats: docs/formats.md. columns: names of the columns of .bin and text files, such as "x y z intensity ring" or
    "float64 x y z"; empty: a text file's own names, what the numbers of a .bin tell, float32 x y z intensity ring in
    .pcd.bin. Other formats name theirs. Where the format tells no origin it is 0, 0, 0.

    Raises UnsupportedCloudError for content that is no scan, holds no usable point or does not tell its columns,
    InputError for a file that cannot be read or has another suffix, MissingDependencyError for .las without laspy and
    .e57 without pye57; each names the file. ConfigError for `columns` that name no x, y, z.
    """
    path, layout = Path(path), read_layout(columns) if columns.strip() else None
    _check_is_file(path)
    try:
        raw = _parse(path, layout)
        clean = clean_points(raw.xyz)
        if not len(clean.points):
            raise UnsupportedCloudError(
                f"expected points, found none that are usable ({len(clean.keep)} stored, {clean.num_nan} NaN or inf, "
                f"{clean.num_zero} at exactly 0, 0, 0)"
            )
    except UnsupportedCloudError as error:
        raise UnsupportedCloudError(f"{path}: {error}") from None
    except MissingDependencyError as error:
        raise MissingDependencyError(f"{path}: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return Scan(clean.points, sensor_origin=np.array(raw.sensor_origin))


def _parse(path: Path, layout: Layout | None) -> RawPoints:
    """By both suffixes of the file, else by the last one."""
    for suffix in ("".join(path.suffixes[-2:]).lower(), path.suffix.lower()):
        if suffix in _COLUMN_PARSERS:
            return _COLUMN_PARSERS[suffix](path.read_bytes(), layout)
        if suffix in _PARSERS:
            return _PARSERS[suffix](path.read_bytes())
        if suffix == ".e57":  # its library opens files only
            return points_from_e57(path)
    raise InputError(f"{path}: expected one of {', '.join(SUFFIXES)}, found suffix '{path.suffix}'")


def _check_is_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: expected a scan file, found a directory")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if not path.is_file():
        raise InputError(f"{path}: expected a regular file")
