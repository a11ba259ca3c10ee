"""PLY files: ASCII and binary of both byte orders; the element `vertex` is the cloud."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.columns import RawPoints, columns_from_text, field_index, strided_columns, text_lines

_DTYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_LONGEST_HEADER = 65536  # bytes


@dataclass
class _Element:
    """dtypes: one entry a property, without byte order, empty where the property is a list."""

    name: str
    count: int
    names: list[str] = field(default_factory=list)
    dtypes: list[str] = field(default_factory=list)

    def sizes(self) -> list[int]:
        """Bytes of every property; UnsupportedCloudError if one is a list, whose length only the data tell."""
        if "" in self.dtypes:
            listed = self.names[self.dtypes.index("")]
            raise UnsupportedCloudError(f"expected plain numbers in element '{self.name}', found list '{listed}'")
        return [np.dtype(d).itemsize for d in self.dtypes]


def points_from_ply(data: bytes) -> RawPoints:
    """Parse the bytes of a PLY file.

    Other elements are skipped, with lists or without; only a list in front of the vertices of a binary file, and a
    list within the vertices, are refused. UnsupportedCloudError too if the header is broken or the data are short.
    """
    end = _END.search(data, 0, _LONGEST_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise UnsupportedCloudError("expected a PLY header from 'ply' to 'end_header', found none")
    encoding, elements = _read_header(data[: end.start()].decode("ascii", "replace"))
    place = field_index([element.name for element in elements], "vertex")
    before, vertex = elements[:place], elements[place]
    xyz = [field_index(vertex.names, name) for name in "xyz"]
    vertex.sizes()
    if encoding == "ascii":
        lines = text_lines(data[end.end() :], sum(element.count for element in before), vertex.count)
        return RawPoints(columns_from_text(lines, len(vertex.names), xyz))
    start = end.end() + sum(element.count * sum(element.sizes()) for element in before if element.count)
    return RawPoints(_binary_columns(np.frombuffer(data, np.uint8), start, vertex, _BYTE_ORDERS[encoding]))


def _read_header(text: str) -> tuple[str, list[_Element]]:
    encoding, elements = "", list[_Element]()
    for line in text.splitlines()[1:]:
        match line.split():
            case ["format", name, *_]:
                encoding = name
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 20:
                elements.append(_Element(name, int(count)))
            case ["property", "list", _, _, name] if elements:
                elements[-1].names.append(name)
                elements[-1].dtypes.append("")
            case ["property", kind, name] if elements and kind in _DTYPES:
                elements[-1].names.append(name)
                elements[-1].dtypes.append(_DTYPES[kind])
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise UnsupportedCloudError(f"expected a line of a PLY header, found '{line.strip():.60}'")
    if encoding not in _BYTE_ORDERS:
        raise UnsupportedCloudError(f"expected format {', '.join(_BYTE_ORDERS)}, found '{encoding:.40}'")
    return encoding, elements


def _binary_columns(data: NDArray[np.uint8], start: int, vertex: _Element, byte_order: str) -> list[NDArray[Any]]:
    sizes = vertex.sizes()
    step = sum(sizes)
    needed = vertex.count * step
    if len(data) < start + needed:
        raise UnsupportedCloudError(
            f"truncated: expected {needed} bytes for {vertex.count} vertices, found {max(len(data) - start, 0)}"
        )
    xyz = [vertex.names.index(name) for name in "xyz"]
    dtypes = [np.dtype(byte_order + vertex.dtypes[i]) for i in xyz]
    return strided_columns(data, vertex.count, dtypes, [start + sum(sizes[:i]) for i in xyz], [step] * 3)
