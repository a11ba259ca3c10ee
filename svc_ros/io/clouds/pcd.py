"""PCD files (Point Cloud Library): ASCII, binary and binary_compressed; binary on the way out."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError, UnsupportedCloudError
from svc_ros.io.clouds.columns import RawPoints, columns_from_text, strided_columns, text_lines, xyz_places

_DTYPES = {f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)}
_DTYPES |= {"F4": "<f4", "F8": "<f8"}
_LONGEST_HEADER = 65536  # bytes


@dataclass(frozen=True)
class _Header:
    """names, dtypes, counts: one entry a field; num_points as declared, not yet compared with the data."""

    names: list[str]
    dtypes: list[np.dtype[Any]]
    counts: list[int]
    num_points: int
    sensor_origin: tuple[float, float, float]
    encoding: str

    def __post_init__(self) -> None:
        for place in self.xyz:
            if self.counts[place] != 1:
                raise UnsupportedCloudError(f"expected COUNT 1 for field '{self.names[place]}', found more or fewer")

    @property
    def xyz(self) -> list[int]:
        return xyz_places(self.names)

    @property
    def field_sizes(self) -> list[int]:
        return [dtype.itemsize * count for dtype, count in zip(self.dtypes, self.counts, strict=True)]


def points_from_pcd(data: bytes) -> RawPoints:
    """Parse the bytes of a PCD file.

    The translation of VIEWPOINT becomes the sensor origin, its rotation is not used: the points are already in the
    frame that both speak of. UnsupportedCloudError if the header is broken or the data do not hold what it declares.
    """
    header, body = _read_header(data)
    return RawPoints(_PARSERS[header.encoding](header, body), header.sensor_origin)


def write_pcd(path: str | os.PathLike[str], points: ArrayLike, sensor_origin: ArrayLike = (0.0, 0.0, 0.0)) -> None:
    """Write points (N, 3) [m] as binary PCD of float32, with the sensor origin (3,) [m] as VIEWPOINT.

    InputError for other shapes and where the file cannot be written.
    """
    xyz, origin = np.asarray(points), np.asarray(sensor_origin, np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or origin.shape != (3,):
        raise InputError(f"{path}: expected points N x 3 and an origin of 3, found {xyz.shape} and {origin.shape}")
    viewpoint = " ".join(repr(float(v)) for v in origin)
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(xyz)}\nHEIGHT 1\nVIEWPOINT {viewpoint} 1 0 0 0\nPOINTS {len(xyz)}\nDATA binary\n"
    )
    try:
        with open(path, "wb") as file:
            file.write(header.encode() + xyz.astype("<f4").tobytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _read_header(data: bytes) -> tuple[_Header, bytes]:
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = data.find(b"\n", start, _LONGEST_HEADER)
        if end < 0:
            raise UnsupportedCloudError("expected a PCD header that ends with a DATA line, found none")
        words = data[start:end].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
        start = end + 1
    return _header_from_entries(entries), data[start:]


def _header_from_entries(entries: dict[str, list[str]]) -> _Header:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes, kinds = entries.get("SIZE", []), entries.get("TYPE", [])
    counts = _whole_numbers(entries, "COUNT") if "COUNT" in entries else [1] * len(names)
    if not names or not len(names) == len(sizes) == len(kinds) == len(counts):
        raise UnsupportedCloudError(
            f"expected FIELDS, SIZE, TYPE and COUNT of equal length, found {len(names)}, {len(sizes)}, {len(kinds)} "
            f"and {len(counts)} entries"
        )
    codes = [kind.upper() + size for kind, size in zip(kinds, sizes, strict=True)]
    for name, code in zip(names, codes, strict=True):
        if code not in _DTYPES:
            raise UnsupportedCloudError(f"field '{name}': expected a type of {', '.join(_DTYPES)}, found {code!r:.20}")
    encoding = " ".join(entries["DATA"]).lower()
    if encoding not in _PARSERS:
        raise UnsupportedCloudError(f"expected DATA {', '.join(_PARSERS)}, found '{encoding:.40}'")
    dtypes = [np.dtype(_DTYPES[code]) for code in codes]
    return _Header(names, dtypes, counts, _num_points(entries), _viewpoint(entries), encoding)


def _whole_numbers(entries: dict[str, list[str]], key: str) -> list[int]:
    words = entries.get(key, [])
    if not all(word.isascii() and word.isdigit() and len(word) < 20 for word in words):
        raise UnsupportedCloudError(f"expected whole numbers in {key}, found '{' '.join(words):.60}'")
    return [int(word) for word in words]


def _num_points(entries: dict[str, list[str]]) -> int:
    size = [_whole_numbers(entries, key) for key in ("WIDTH", "HEIGHT", "POINTS")]
    if any(len(values) > 1 for values in size):
        raise UnsupportedCloudError("expected one number in each of WIDTH, HEIGHT and POINTS, found more")
    width, height, points = (values[0] if values else None for values in size)
    product = None if width is None or height is None else width * height
    if points is not None and product == 0:  # some writers tell the number of points only
        return points
    if points is None and product is None:
        raise UnsupportedCloudError("expected POINTS, or WIDTH and HEIGHT, found neither")
    if points is not None and product is not None and points != product:
        raise UnsupportedCloudError(f"expected POINTS to be WIDTH x HEIGHT = {product}, found {points}")
    return points if points is not None else product or 0


def _viewpoint(entries: dict[str, list[str]]) -> tuple[float, float, float]:
    words = entries.get("VIEWPOINT", ["0"] * 7)
    try:
        x, y, z, *_rotation = numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 7 or not np.isfinite(numbers).all():
        raise UnsupportedCloudError(f"expected seven numbers in VIEWPOINT, found '{' '.join(words):.80}'")
    return x, y, z


def _from_ascii(header: _Header, body: bytes) -> list[NDArray[Any]]:
    firsts = [sum(header.counts[:i]) for i in header.xyz]
    lines = text_lines(body, 0, header.num_points)
    return list(columns_from_text(lines, sum(header.counts), firsts))


def _from_binary(header: _Header, body: bytes) -> list[NDArray[Any]]:
    step = sum(header.field_sizes)
    if len(body) < step * header.num_points:
        raise UnsupportedCloudError(
            f"truncated: expected {step * header.num_points} bytes for {header.num_points} points, found {len(body)}"
        )
    offsets = [sum(header.field_sizes[:i]) for i in header.xyz]
    dtypes = [header.dtypes[i] for i in header.xyz]
    return strided_columns(np.frombuffer(body, np.uint8), header.num_points, dtypes, offsets, [step] * 3)


def _from_compressed(header: _Header, body: bytes) -> list[NDArray[Any]]:
    """Fields lie one after the other here: all x, then all y ..."""
    from svc_ros.io.clouds.lzf import lzf_decompress  # compiles when imported, and few files need it

    if len(body) < 8:
        raise UnsupportedCloudError(
            f"truncated: expected 8 bytes of sizes before the compressed data, found {len(body)}"
        )
    packed_size, size = (int(v) for v in np.frombuffer(body, "<u4", 2))
    packed = np.frombuffer(body, np.uint8, offset=8)
    expected = sum(header.field_sizes) * header.num_points
    if size != expected:
        raise UnsupportedCloudError(f"expected {expected} bytes for {header.num_points} points, found {size} declared")
    if len(packed) < packed_size:
        raise UnsupportedCloudError(f"truncated: expected {packed_size} compressed bytes, found {len(packed)}")
    data = lzf_decompress(packed[:packed_size], size)
    offsets = [sum(header.field_sizes[:i]) * header.num_points for i in header.xyz]
    dtypes = [header.dtypes[i] for i in header.xyz]
    return strided_columns(data, header.num_points, dtypes, offsets, [d.itemsize for d in dtypes])


_PARSERS = {"ascii": _from_ascii, "binary": _from_binary, "binary_compressed": _from_compressed}
