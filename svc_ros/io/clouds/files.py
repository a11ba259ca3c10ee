"""One scan from one file, whatever its format."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from svc_ros.core.errors import InputError, UnsupportedCloudError
from svc_ros.core.scan import Scan
from svc_ros.io.clouds.array import points_from_bin, points_from_npy, points_from_npz, points_from_nuscenes
from svc_ros.io.clouds.columns import clean_points
from svc_ros.io.clouds.las import points_from_las
from svc_ros.io.clouds.pcd import points_from_pcd, write_pcd
from svc_ros.io.clouds.ply import points_from_ply

__all__ = ["SUFFIXES", "read_scan", "write_pcd"]

_PARSERS = {
    ".bin": points_from_bin,
    ".pcd.bin": points_from_nuscenes,
    ".pcd": points_from_pcd,
    ".ply": points_from_ply,
    ".npy": points_from_npy,
    ".npz": points_from_npz,
    ".las": points_from_las,
    ".laz": points_from_las,
}
SUFFIXES = tuple(_PARSERS)


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """Read the points [m] of a file in its own frame; NaN, inf and points at exactly 0, 0, 0 are dropped.

    .bin (KITTI: float32 x y z intensity), .pcd.bin (nuScenes: float32 x y z intensity ring), .pcd (ASCII, binary,
    compressed; the translation of VIEWPOINT becomes `sensor_origin`), .ply (ASCII, binary), .npy and .npz (no pickles;
    array `points` or the only one), .las and .laz. Where the format tells no origin it is 0, 0, 0.

    Raises UnsupportedCloudError for content that is no scan or holds no usable point, InputError for a file that
    cannot be read or has another suffix, MissingDependencyError for .las without laspy; each names the file.
    """
    path = Path(path)
    _check_is_file(path)
    parse = _PARSERS.get("".join(path.suffixes[-2:]).lower()) or _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"{path}: expected one of {', '.join(SUFFIXES)}, found suffix '{path.suffix}'")
    try:
        raw = parse(path.read_bytes())
        clean = clean_points(raw.xyz)
        if not len(clean.points):
            raise UnsupportedCloudError(
                f"expected points, found none that are usable ({len(clean.keep)} stored, {clean.num_nan} NaN or inf, "
                f"{clean.num_zero} at exactly 0, 0, 0)"
            )
    except UnsupportedCloudError as error:
        raise UnsupportedCloudError(f"{path}: {error}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return Scan(clean.points, sensor_origin=np.array(raw.sensor_origin))


def _check_is_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: expected a scan file, found a directory")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if not path.is_file():
        raise InputError(f"{path}: expected a regular file")
