"""PLY files: ASCII and binary of both byte orders; the element `vertex` is the cloud."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.columns import (
    RawPoints,
    columns_from_text,
    field_index,
    strided_columns,
    text_lines,
    xyz_places,
)

_DTYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_LONGEST_HEADER = 65536  # bytes


@dataclass(frozen=True)
class _Property:
    """dtype: of its values, without byte order; count_dtype: of the number of values before them, "" if no list."""

    name: str
    dtype: str
    count_dtype: str = ""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        return [one.name for one in self.properties]

    @property
    def has_lists(self) -> bool:
        return any(one.count_dtype for one in self.properties)

    def sizes(self) -> list[int]:
        """Bytes of a value of every property."""
        return [np.dtype(one.dtype).itemsize for one in self.properties]


def points_from_ply(data: bytes) -> RawPoints:
    """Parse the bytes of a PLY file: x, y, z of the element `vertex`; other elements and all lists are skipped.

    UnsupportedCloudError if the header is broken, x, y or z is a list, or the data are short.
    """
    end = _END.search(data, 0, _LONGEST_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise UnsupportedCloudError("expected a PLY header from 'ply' to 'end_header', found none")
    encoding, elements = _read_header(data[: end.start()].decode("ascii", "replace"))
    place = field_index([element.name for element in elements], "vertex")
    before, vertex = elements[:place], elements[place]
    xyz = xyz_places(vertex.names)
    if any(vertex.properties[i].count_dtype for i in xyz):
        raise UnsupportedCloudError("expected one number for each of x, y and z, found a list")
    if encoding == "ascii":
        lines = text_lines(data[end.end() :], sum(element.count for element in before), vertex.count)
        if vertex.has_lists:
            lines = [_without_lists(line, vertex) for line in lines]
            vertex = _Element(vertex.name, vertex.count, [one for one in vertex.properties if not one.count_dtype])
        return RawPoints(columns_from_text(lines, len(vertex.names), xyz_places(vertex.names)))
    start, order = end.end(), _BYTE_ORDERS[encoding]
    for element in before:
        if element.has_lists:
            start = _rows(data, start, element, order)[-1]
        else:
            start += element.count * sum(element.sizes())
    return RawPoints(_binary_columns(data, start, vertex, xyz, order))


def _read_header(text: str) -> tuple[str, list[_Element]]:
    encoding, elements = "", list[_Element]()
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", name, *_]:
                encoding = name
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 20:
                elements.append(_Element(name, int(count)))
            case ["property", "list", count, kind, name] if (
                elements and kind in _DTYPES and _DTYPES.get(count, "f")[0] != "f"
            ):
                elements[-1].properties.append(_Property(name, _DTYPES[kind], _DTYPES[count]))
            case ["property", kind, name] if elements and kind in _DTYPES:
                elements[-1].properties.append(_Property(name, _DTYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise UnsupportedCloudError(f"expected a line of a PLY header, found '{line.strip():.60}'")
    if encoding not in _BYTE_ORDERS:
        raise UnsupportedCloudError(f"expected format {', '.join(_BYTE_ORDERS)}, found '{encoding:.40}'")
    return encoding, elements


def _without_lists(line: str, element: _Element) -> str:
    """The values of a line that are in no list."""
    values, kept, at = line.split(), list[str](), 0
    for one in element.properties:
        if not one.count_dtype:
            kept += values[at : at + 1]
        elif at < len(values):
            if not values[at].isdecimal() or len(values[at]) >= 20:
                raise UnsupportedCloudError(f"expected the length of list '{one.name}', found '{values[at]:.40}'")
            at += int(values[at])
        at += 1
    if at != len(values):
        raise UnsupportedCloudError(f"expected {at} values in a line with lists, found {len(values)}")
    return " ".join(kept)


def _rows(data: bytes, start: int, element: _Element, byte_order: str, wanted: int = -1) -> list[int]:
    """Byte where property number `wanted` of each row begins, and at last that where the element ends."""
    places, at = list[int](), start
    counts = [
        struct.Struct(byte_order + np.dtype(one.count_dtype).char) if one.count_dtype else None
        for one in element.properties
    ]
    sizes = element.sizes()
    for _ in range(element.count):
        for number, (count, size) in enumerate(zip(counts, sizes, strict=True)):
            if number == wanted:
                places.append(at)
            if count is None:
                at += size
            elif at + count.size > len(data):
                at = len(data) + 1
            else:
                (length,) = count.unpack_from(data, at)
                at += count.size + max(length, 0) * size
        if at > len(data):
            raise UnsupportedCloudError(f"truncated: expected {element.count} of '{element.name}', found fewer")
    return [*places, at]


def _binary_columns(
    data: bytes, start: int, vertex: _Element, xyz: Sequence[int], byte_order: str
) -> list[NDArray[Any]]:
    dtypes = [np.dtype(byte_order + vertex.properties[i].dtype) for i in xyz]
    raw = np.frombuffer(data, np.uint8)
    if vertex.has_lists:
        places = [_rows(data, start, vertex, byte_order, i)[:-1] for i in xyz]
        return [_gathered(raw, *column) for column in zip(places, dtypes, strict=True)]
    sizes = vertex.sizes()
    step = sum(sizes)
    needed = vertex.count * step
    if len(data) < start + needed:
        raise UnsupportedCloudError(
            f"truncated: expected {needed} bytes for {vertex.count} vertices, found {max(len(data) - start, 0)}"
        )
    return strided_columns(raw, vertex.count, dtypes, [start + sum(sizes[:i]) for i in xyz], [step] * 3)


def _gathered(data: NDArray[np.uint8], places: Sequence[int], dtype: np.dtype[Any]) -> NDArray[Any]:
    """(N,) values that begin at these bytes."""
    values: NDArray[Any] = data[np.array(places, np.int64)[:, None] + np.arange(dtype.itemsize)].view(dtype)
    return values.reshape(-1)
