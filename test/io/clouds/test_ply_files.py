"""PLY files of every format: right ones, and each way of being broken."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scan_file_checks import POINTS, STORED, assert_read, assert_refused, write


def ply(body: bytes, encoding: str, *elements: str) -> bytes:
    lines = ["ply", f"format {encoding} 1.0", "comment made by hand", *elements, "end_header"]
    return "".join(f"{line}\n" for line in lines).encode() + body


def vertices(count: int, kind: str = "float", *extra: str) -> list[str]:
    return [f"element vertex {count}", *(f"property {kind} {name}" for name in "xyz"), *extra]


def as_text(points: Any, tail: str = "") -> bytes:
    return "".join(f"{x} {y} {z}{tail}\n" for x, y, z in points).encode()


@pytest.mark.parametrize(("kind", "code"), [("float", "f4"), ("double", "f8"), ("float32", "f4"), ("float64", "f8")])
@pytest.mark.parametrize(("encoding", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_ply_binary(tmp_path: Path, encoding: str, order: str, kind: str, code: str) -> None:
    body = STORED.astype(order + code).tobytes()
    assert_read(write(tmp_path / "scan.ply", ply(body, encoding, *vertices(len(STORED), kind))))


def test_ply_ascii(tmp_path: Path) -> None:
    assert_read(write(tmp_path / "scan.ply", ply(as_text(STORED), "ascii", *vertices(len(STORED)))))


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_extra_properties_in_any_order(tmp_path: Path, order: str) -> None:
    types = {"red": "u1", "z": "f8", "y": "f4", "n": "i2", "x": "f4"}
    table = np.zeros(4, [(name, order + code) for name, code in types.items()])
    for i, name in enumerate("xyz"):
        table[name] = POINTS[:, i]
    lines = ["uchar red", "double z", "float y", "short n", "float x"]
    header = ["element vertex 4", *(f"property {line}" for line in lines)]
    encoding = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    assert_read(write(tmp_path / "scan.ply", ply(table.tobytes(), encoding, *header)))


FACES = ["element face 1", "property list uchar int vertex_indices"]
CAMERAS = ["element camera 2", "property float view_px", "property uchar flag"]


def test_ply_other_elements_are_skipped(tmp_path: Path) -> None:
    body = POINTS.astype("<f4").tobytes()
    faces = struct.pack("<Biii", 3, 0, 1, 2)
    for elements, data in (
        ([*vertices(4), *FACES], body + faces),
        ([*CAMERAS, *vertices(4), *FACES], bytes(10) + body + faces),
        (["element face 0", FACES[1], *vertices(4)], body),
    ):
        assert_read(write(tmp_path / "scan.ply", ply(data, "binary_little_endian", *elements)))
    data = b"3 0 1 2\n" + as_text(POINTS)
    assert_read(write(tmp_path / "scan.ply", ply(data, "ascii", *FACES, *vertices(4))))


ENCODINGS = {"binary_little_endian": "<", "binary_big_endian": ">"}
SEEN = ["element vertex 4", "property float x", "property list uchar short seen", *vertices(4)[2:]]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_ply_lists_are_skipped(tmp_path: Path, encoding: str) -> None:
    order = ENCODINGS[encoding]
    faces = struct.pack(f"{order}BiiiBiiiiB", 3, 0, 1, 2, 4, 0, 1, 2, 3, 0)
    elements = ["element face 3", FACES[1], *CAMERAS, *vertices(4)]
    data = faces + bytes(10) + POINTS.astype(order + "f4").tobytes()
    assert_read(write(tmp_path / "a.ply", ply(data, encoding, *elements)))
    rows = [
        struct.pack(f"{order}fB{count}hff", x, count, *range(count), y, z) for count, (x, y, z) in enumerate(POINTS)
    ]
    assert_read(write(tmp_path / "b.ply", ply(b"".join(rows), encoding, *SEEN)))


def test_ply_lists_are_skipped_in_ascii(tmp_path: Path) -> None:
    rows = [f"{x} {count} {'7 ' * count}{y} {z}\n" for count, (x, y, z) in enumerate(POINTS)]
    assert_read(write(tmp_path / "a.ply", ply("".join(rows).encode(), "ascii", *SEEN)))
    rows[2] = "1 5 7 7 2 3\n"
    assert_refused(write(tmp_path / "b.ply", ply("".join(rows).encode(), "ascii", *SEEN)), "in a line with lists")
    rows[2] = "1 many 7 2 3\n"
    assert_refused(write(tmp_path / "c.ply", ply("".join(rows).encode(), "ascii", *SEEN)), "'seen'", "'many'")


@pytest.mark.parametrize("count", [4, 10**12])
def test_ply_lists_cut_off(tmp_path: Path, count: int) -> None:
    elements = [f"element face {count}", FACES[1], *vertices(4)]
    data = struct.pack("<BiiiB", 3, 0, 1, 2, 200)
    assert_refused(write(tmp_path / "a.ply", ply(data, "binary_little_endian", *elements)), "truncated", "'face'")


def test_ply_coordinates_as_lists_are_refused(tmp_path: Path) -> None:
    elements = ["element vertex 4", "property list uchar float x", "property float y", "property float z"]
    assert_refused(write(tmp_path / "a.ply", ply(bytes(100), "binary_little_endian", *elements)), "found a list")


def test_ply_names_in_capitals(tmp_path: Path) -> None:
    elements = ["element vertex 4", *(f"property float {name}" for name in "XYZ")]
    assert_read(write(tmp_path / "a.ply", ply(POINTS.astype("<f4").tobytes(), "binary_little_endian", *elements)))


def test_ply_with_foreign_line_ends(tmp_path: Path) -> None:
    data = ply(b"", "binary_little_endian", *vertices(4)).replace(b"\n", b"\r\n") + POINTS.astype("<f4").tobytes()
    assert_read(write(tmp_path / "scan.ply", data))


BROKEN_PLY = {
    "no x": (["element vertex 4", "property float y", "property float z"], "'x', found 0 in: y, z"),
    "x twice": (vertices(4, "float", "property float x"), "'x', found 2"),
    "no vertices": (["element face 4", "property float x"], "'vertex', found 0 in: face"),
    "unknown type": (vertices(4, "half"), "property half x"),
    "property first": (["property float x", *vertices(4)], "found 'property float x'"),
    "count of words": (["element vertex four"], "element vertex four"),
    "list of lists": ([*vertices(4), "property list float int seen"], "property list float int seen"),
    "negative count": (["element vertex -4"], "element vertex -4"),
}


@pytest.mark.parametrize("name", BROKEN_PLY)
def test_ply_broken_header(tmp_path: Path, name: str) -> None:
    elements, cause = BROKEN_PLY[name]
    assert_refused(write(tmp_path / "scan.ply", ply(bytes(100), "binary_little_endian", *elements)), "expected", cause)


def test_ply_of_unknown_format(tmp_path: Path) -> None:
    assert_refused(write(tmp_path / "scan.ply", ply(bytes(100), "binary_mixed", *vertices(4))), "'binary_mixed'")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("count", [5, 10**12, 10**19 - 1])
def test_ply_truncated_or_claiming_too_much(tmp_path: Path, encoding: str, count: int) -> None:
    body = as_text(POINTS) if encoding == "ascii" else bytes(12 * 4 + 11)
    assert_refused(write(tmp_path / "a.ply", ply(body, encoding, *vertices(count))), "truncated", "found")
    before = [f"element camera {count}", "property float px"]
    assert_refused(write(tmp_path / "b.ply", ply(body, encoding, *before, *vertices(4))), "truncated", "found")


def test_ply_truncated_anywhere(tmp_path: Path) -> None:
    data = ply(POINTS.astype("<f4").tobytes(), "binary_little_endian", *vertices(4))
    for length in range(len(data)):
        assert_refused(write(tmp_path / "scan.ply", data[:length]), "expected")
