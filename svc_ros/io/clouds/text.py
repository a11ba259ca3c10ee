"""Clouds as text: a point a line, with a line of names or without, whatever is between the values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from svc_ros.core.errors import UnsupportedCloudError
from svc_ros.io.clouds.columns import RawPoints, columns_from_text, xyz_places
from svc_ros.io.clouds.columns_guess import LARGEST_M, NAME_THEM
from svc_ros.io.clouds.layout import Layout

_BLANKS = bytes.maketrans(b",;\t\"'\f", b"      ")
_BLANKS_AND_POINTS = bytes.maketrans(b",;\t\"'\f", b".     ")  # where a comma is the decimal point
_UNDERSCORES = bytes.maketrans(b" \t", b"__")
_NO_TEXT = bytes(set(range(32)) - set(b"\t\n\r\f"))
_COMMENTS = ("#", "//", "%", "sep=")  # the last one by Excel
_COMMA_NUMBER = re.compile(r"[-+]?\d*(,\d+)?(e[-+]?\d+)?", re.IGNORECASE)
_WHOLE_NUMBER = re.compile(rb"[-+]?\d+")
_UNIT = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]")
_METRES = ("m", "meter", "meters", "metre", "metres", "")
_OTHER_NAMES = {f"{name}{axis}": "xyz"[axis] for name in ("points:", "points_") for axis in range(3)}  # of ParaView
_OTHER_NAMES |= {f"{name}_m": name for name in "xyz"}
_LOOKED_AT = 100  # lines that tell what a comma is


class _Head(NamedTuple):
    """names: of the columns, empty where none are told; first: number of the line of the first point, from 0;
    num_points: as told, None where that is not; mark: the comma or semicolon between the names and the values."""

    names: list[str]
    first: int
    num_points: int | None
    mark: bytes = b""


def points_from_text(data: bytes, layout: Layout | None) -> RawPoints:
    """Parse lines of values apart by blanks, tabs, commas or semicolons; empty ones between commas are NaN.

    layout: the columns, None: those of a line of names, else x, y, z are the first three. Lines that begin with #, //
    or % are comments, which may name the columns; before the points a line may tell their count. UnsupportedCloudError
    with the number of the line that is none of these.
    """
    lines = _lines(data)
    head = _read_head(lines, layout)
    body = lines[head.first :]
    table = _BLANKS_AND_POINTS if _are_commas_decimal(body) else _BLANKS
    values = [line.decode("ascii", "replace") for line in _joined(body, head.mark).translate(table).split(b"\n")]
    kept = [k for k, line in enumerate(values) if line.strip() and not line.lstrip().startswith(_COMMENTS)]
    width = len(values[kept[0]].split())
    wanted = _wanted(head, layout, width)
    columns = columns_from_text([values[k] for k in kept], width, wanted, lambda k: f"line {head.first + kept[k] + 1}")
    if head.num_points is not None and len(kept) < head.num_points:
        raise UnsupportedCloudError(f"truncated: expected {head.num_points} lines of points, found {len(kept)}")
    if not head.names and layout is None:
        _check_unnamed(columns, width, body)
    return RawPoints(columns)


def _lines(data: bytes) -> list[bytes]:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise UnsupportedCloudError("expected text in UTF-8 or ASCII, found UTF-16")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if len(data.translate(None, _NO_TEXT)) != len(data):
        raise UnsupportedCloudError("expected lines of text, found bytes that are no text")
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for mark in (b",", b";"):  # an empty value must not move those after it
        data = data.replace(mark * 2, mark + b"nan" + mark).replace(mark * 2, mark + b"nan" + mark)
        data = data.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
    return data.split(b"\n")


def _read_head(lines: Sequence[bytes], layout: Layout | None) -> _Head:
    names: list[str] = []
    count, told, mark = None, False, b""
    for number, raw in enumerate(lines):
        line = raw.decode("utf-8", "replace").strip()
        if not line:
            continue
        if line.startswith(_COMMENTS):
            found = _names(line.lstrip("#/% "))
            if not told and all(found.count(name) == 1 for name in "xyz"):
                names = found
                _check_units(line)
            continue
        values = raw.translate(_BLANKS).split()
        if count is None and len(values) == 1 and values[0].isdigit() and len(values[0]) < 20:
            count = int(values[0])
        elif told or any(map(_is_number, values[:3])):
            if not told and names[:3] == ["x", "y", "z"] and len(names) != len(values):
                names = []  # a remark; without names they are the first three, too
            return _Head(names, number, count, mark if mark in raw else b"")
        else:
            names, told = _names(line), True
            mark = next((mark for mark in (b";", b",") if mark in raw), b"")
            if layout is None:
                xyz_places(names)
                _check_units(line)
    raise UnsupportedCloudError("expected lines of numbers, found none")


def _joined(body: Sequence[bytes], mark: bytes) -> bytes:
    """All lines; where a mark is between the values, blanks within one do not make it two."""
    joined = b"\n".join(body)
    if not mark or (b" " not in joined and b"\t" not in joined):
        return joined
    return re.sub(rb"[ \t]*([\n%b])[ \t]*" % mark, rb"\1", joined.strip(b" \t")).translate(_UNDERSCORES)


def _is_number(value: bytes) -> bool:
    try:
        float(value)
    except ValueError:
        return False
    return True


def _names(line: str) -> list[str]:
    """Of columns, in small letters, x, y and z also where another program calls them otherwise."""
    mark = next((mark for mark in ";,\t" if mark in line), None)
    without_units = _UNIT.sub("", line)
    parts = without_units.split(mark) if mark else re.findall(r'"[^"]*"|\S+', without_units)
    names = [part.strip().strip("\"'").strip().lower() for part in parts]
    return [_OTHER_NAMES.get(name, name) for name in names]


def _check_units(line: str) -> None:
    for axis, unit in re.findall(r"\b([xyz])\W*?[\[(]\s*([^\])]*?)\s*[\])]", line, re.IGNORECASE):
        if unit.lower() not in _METRES:
            raise UnsupportedCloudError(f"expected metres, found {axis} in '{unit:.20}'")


def _are_commas_decimal(lines: Sequence[bytes]) -> bool:
    """Whether a comma is a decimal point: between numbers that semicolons or blanks set apart, and no point is."""
    decimal = False
    for raw in islice(filter(None, map(bytes.strip, lines)), _LOOKED_AT):
        line = raw.decode("ascii", "replace")
        fields = [field.strip() for field in (line.split(";") if ";" in line else line.split())]
        if len(fields) < 3 or not all(map(_COMMA_NUMBER.fullmatch, fields)):
            return False
        decimal = decimal or "," in line
    return decimal


def _wanted(head: _Head, layout: Layout | None, width: int) -> list[int]:
    names = head.names if layout is None else list(layout.names)
    if not names:
        if width < 3:
            raise UnsupportedCloudError(
                f"expected at least three values a point, found {width} at line {head.first + 1}"
            )
        return [0, 1, 2]
    if len(names) != width:
        raise UnsupportedCloudError(
            f"expected {len(names)} values a point ({'--columns ' if layout else ''}{', '.join(names):.80}), "
            f"found {width} at line {head.first + 1}"
        )
    return xyz_places(names)


def _check_unnamed(columns: Sequence[np.ndarray], width: int, body: Sequence[bytes]) -> None:
    """Refuse three ways in which the first three columns are not x, y and z."""
    first = columns[0]
    if len(first) > 2 and np.array_equal(first - first[0], np.arange(len(first))) and first[0] in (0, 1):
        raise UnsupportedCloudError(f"expected x, y, z first, found the number of the line; {NAME_THEM}")
    beyond = float(np.mean([np.abs(column) > LARGEST_M for column in columns]))
    if beyond > 0.1:
        raise UnsupportedCloudError(f"expected x, y, z in metres first, found values beyond {LARGEST_M:g}; {NAME_THEM}")
    looked_at = [line for line in body[:_LOOKED_AT] if line.strip()]
    whole = all(_WHOLE_NUMBER.fullmatch(part.strip()) for line in looked_at for part in line.split(b","))
    if width >= 6 and width % 2 == 0 and whole:
        raise UnsupportedCloudError(
            f"expected commas either between values or as decimal points, found {width} whole numbers a line, which "
            f"can be both; {NAME_THEM}"
        )
