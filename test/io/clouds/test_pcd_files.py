"""PCD files of every encoding: right ones, and each way of being broken."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lzf_compression import lzf_compress
from scan_file_checks import POINTS, STORED, assert_read, assert_refused, write

from svc_ros.core.errors import InputError
from svc_ros.io.clouds.files import write_pcd

PCD_TYPES = {"F4": "<f4", "F8": "<f8", "I1": "<i1", "I2": "<i2", "I4": "<i4", "I8": "<i8", "U1": "<u1", "U2": "<u2"}


def pcd(columns: dict[str, tuple[str, Any]], encoding: str = "binary", **entries: str) -> bytes:
    """columns: name -> (type and size, values (N,) or (N, count)); entries replace header lines, "" removes them."""
    arrays = [np.asarray(values).astype(PCD_TYPES[code]) for code, values in columns.values()]
    arrays = [a.reshape(len(a), *a.shape[1:] or (1,)) for a in arrays]
    codes, count = [code for code, _ in columns.values()], len(arrays[0])
    header = {
        "VERSION": "0.7",
        "FIELDS": " ".join(columns),
        "SIZE": " ".join(code[1:] for code in codes),
        "TYPE": " ".join(code[:1] for code in codes),
        "COUNT": " ".join(str(a.shape[1]) for a in arrays),
        "WIDTH": str(count),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(count),
        "DATA": encoding,
    } | entries
    text = "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in header.items() if value)
    return text.encode() + PCD_BODIES[encoding](arrays)


def _ascii_body(arrays: list[Any]) -> bytes:
    rows = zip(*arrays, strict=True)
    return "".join(" ".join(repr(v.item()) for a in row for v in a) + "\n" for row in rows).encode()


def _binary_body(arrays: list[Any]) -> bytes:
    return b"".join(a.tobytes() for row in zip(*arrays, strict=True) for a in row)


def _compressed_body(arrays: list[Any]) -> bytes:
    data = b"".join(a.tobytes() for a in arrays)
    packed = lzf_compress(data)
    return struct.pack("<II", len(packed), len(data)) + packed


PCD_BODIES = {"ascii": _ascii_body, "binary": _binary_body, "binary_compressed": _compressed_body}
ENCODINGS = tuple(PCD_BODIES)


def xyz(points: Any, code: str = "F4") -> dict[str, tuple[str, Any]]:
    return {name: (code, column) for name, column in zip("xyz", np.asarray(points).T, strict=True)}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("code", ["F4", "F8"])
def test_pcd(tmp_path: Path, encoding: str, code: str) -> None:
    assert_read(write(tmp_path / "scan.pcd", pcd(xyz(STORED, code), encoding)))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_fields_of_any_order_type_and_count(tmp_path: Path, encoding: str) -> None:
    columns = {
        "intensity": ("U1", np.arange(4)),
        "z": ("F8", POINTS[:, 2]),
        "normal": ("F4", np.ones((4, 3))),
        "y": ("F4", POINTS[:, 1]),
        "label": ("U2", np.arange(4) + 400),
        "x": ("F4", POINTS[:, 0]),
    }
    assert_read(write(tmp_path / "scan.pcd", pcd(columns, encoding)))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_of_integers(tmp_path: Path, encoding: str) -> None:
    points = [[1, -2, 3], [100, 5, -6]]
    x, y, z = np.array(points).T
    columns = {"x": ("I1", x), "y": ("I2", y), "z": ("I8", z)}
    assert_read(write(tmp_path / "scan.pcd", pcd(columns, encoding)), points)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_viewpoint_is_the_sensor_origin(tmp_path: Path, encoding: str) -> None:
    path = write(tmp_path / "scan.pcd", pcd(xyz(POINTS), encoding, VIEWPOINT="1.5 -2 0.25 0.7 0 0.7 0"))
    assert_read(path, origin=(1.5, -2, 0.25))


def test_pcd_without_what_may_be_missing(tmp_path: Path) -> None:
    assert_read(write(tmp_path / "a.pcd", pcd(xyz(POINTS), COUNT="", VIEWPOINT="", POINTS="", VERSION="")))
    assert_read(write(tmp_path / "b.pcd", pcd(xyz(POINTS), WIDTH="", HEIGHT="")))


def test_pcd_with_foreign_line_ends_and_organised(tmp_path: Path) -> None:
    data = pcd(xyz(STORED[:6]), "ascii", WIDTH="3", HEIGHT="2").replace(b"\n", b"\r\n")
    assert_read(write(tmp_path / "scan.pcd", data), POINTS[:3])


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_that_tells_its_size_in_points_only(tmp_path: Path, encoding: str) -> None:
    for width, height in (("0", "0"), ("0", "1"), ("4", "0")):
        assert_read(write(tmp_path / "a.pcd", pcd(xyz(POINTS), encoding, WIDTH=width, HEIGHT=height)))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_names_in_capitals_and_padding(tmp_path: Path, encoding: str) -> None:
    padding = ("U1", np.ones((4, 3)))
    columns = {"_": padding, **dict(zip("XYZ", xyz(POINTS).values(), strict=True)), "x_": padding}
    assert_read(write(tmp_path / "a.pcd", pcd(columns, encoding, FIELDS="_ X Y Z _")))
    columns = xyz(POINTS) | {"X": ("F4", np.zeros(4))}
    assert_read(write(tmp_path / "b.pcd", pcd(columns, encoding)))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_pcd_keywords_in_any_case_among_comments(tmp_path: Path, encoding: str) -> None:
    data = pcd(xyz(POINTS), encoding, DATA="@")
    head, _, body = data.partition(b"DATA @\n")
    lines = b"# more\n".join(line + b"\n" for line in head.lower().splitlines())
    assert_read(write(tmp_path / "a.pcd", lines + f"Data {encoding.upper()} \t\n".encode() + body))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("cut", [1, 5, 30])
def test_pcd_truncated_data(tmp_path: Path, encoding: str, cut: int) -> None:
    points = np.random.default_rng(0).normal(size=(6, 3)).astype("<f4")
    data = pcd(xyz(points, "F8"), encoding)[: -cut - (encoding == "ascii")]
    if encoding == "ascii":
        data = data[: data.rindex(b" ")]  # a number that lost its last digits still is one
    assert_refused(write(tmp_path / "scan.pcd", data), "expected", "found")


def test_pcd_truncated_anywhere(tmp_path: Path) -> None:
    data = pcd(xyz(POINTS, "F8"), "binary_compressed")
    for length in range(len(data)):
        assert_refused(write(tmp_path / "scan.pcd", data[:length]), "expected")


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count", ["1000000000000", "10000000000000000000"])
def test_pcd_that_claims_too_many_points(tmp_path: Path, encoding: str, count: str) -> None:
    data = pcd(xyz(POINTS), encoding, WIDTH=count, POINTS=count)
    assert_refused(write(tmp_path / "scan.pcd", data), "expected", "found")


def test_pcd_that_claims_too_many_compressed_bytes(tmp_path: Path) -> None:
    header = pcd(xyz(np.empty((0, 3))), "binary", WIDTH="300000000", POINTS="300000000", DATA="binary_compressed")
    path = write(tmp_path / "scan.pcd", header + struct.pack("<II", 100, 3_600_000_000) + bytes(100))
    assert_refused(path, "cannot hold", "3600000000")


BROKEN_HEADERS = {
    "no x": ({"FIELDS": "range y z"}, "'x', found 0 in: range, y, z"),
    "x twice": ({"FIELDS": "x x z"}, "'x', found 2"),
    "no fields": ({"FIELDS": ""}, "FIELDS, SIZE, TYPE and COUNT"),
    "short sizes": ({"SIZE": "4 4"}, "3, 2, 3 and 3"),
    "unknown type": ({"TYPE": "F Q F"}, "'Q4'"),
    "unknown size": ({"SIZE": "4 2 4"}, "'F2'"),
    "several values": ({"COUNT": "1 2 1"}, "COUNT 1 for field 'y'"),
    "count of words": ({"COUNT": "1 one 1"}, "whole numbers in COUNT"),
    "negative": ({"POINTS": "-4"}, "whole numbers in POINTS"),
    "two widths": ({"WIDTH": "2 2"}, "found more"),
    "no size": ({"WIDTH": "", "POINTS": ""}, "found neither"),
    "other size": ({"POINTS": "3"}, "WIDTH x HEIGHT = 4, found 3"),
    "short viewpoint": ({"VIEWPOINT": "1 2 3"}, "seven numbers in VIEWPOINT"),
    "word in viewpoint": ({"VIEWPOINT": "a 0 0 1 0 0 0"}, "seven numbers in VIEWPOINT"),
    "nan viewpoint": ({"VIEWPOINT": "nan 0 0 1 0 0 0"}, "seven numbers in VIEWPOINT"),
}


@pytest.mark.parametrize("name", BROKEN_HEADERS)
def test_pcd_broken_header(tmp_path: Path, name: str) -> None:
    entries, cause = BROKEN_HEADERS[name]
    assert_refused(write(tmp_path / "scan.pcd", pcd(xyz(POINTS), **entries)), "expected", cause)


def test_pcd_of_unknown_encoding(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.pcd", pcd(xyz(POINTS)).replace(b"DATA binary", b"DATA zipped"))
    assert_refused(path, "'zipped'", "binary_compressed")


def test_pcd_of_noise(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).bytes(200_000)
    assert_refused(write(tmp_path / "scan.pcd", noise), "PCD header")


@pytest.mark.parametrize(("line", "cause"), [("1 2", "found 2 at point 1"), ("1 2 x", "text"), ("1 2 3 4", "found 4")])
def test_pcd_ascii_with_a_wrong_line(tmp_path: Path, line: str, cause: str) -> None:
    lines = pcd(xyz(POINTS), "ascii").decode().splitlines()
    lines[-3] = line
    assert_refused(write(tmp_path / "scan.pcd", "\n".join(lines)), "expected", cause)


def test_pcd_without_points(tmp_path: Path) -> None:
    for encoding in ENCODINGS:
        assert_refused(write(tmp_path / "scan.pcd", pcd(xyz(np.empty((0, 3))), encoding)), "0 stored")


def test_written_pcd_reads_back(tmp_path: Path) -> None:
    points = np.random.default_rng(3).normal(size=(1000, 3)) * 50
    write_pcd(tmp_path / "scan.pcd", points, sensor_origin=[0.1, -2.5, 1e-9])
    assert_read(tmp_path / "scan.pcd", points.astype(np.float32), origin=(0.1, -2.5, 1e-9))


def test_pcd_is_written_for_points_only_and_where_there_is_room(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="N x 3"):
        write_pcd(tmp_path / "scan.pcd", np.zeros((3, 4)))
    with pytest.raises(InputError, match=r"missing.scan\.pcd: cannot be written: No such file"):
        write_pcd(tmp_path / "missing" / "scan.pcd", POINTS)
