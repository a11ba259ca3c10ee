"""Matrices of fragment pairs as text: the .log and .info files of the geometric registration benchmark.

A block is a line `i j n` (two fragments, and how many there are) and the rows of a square matrix.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_matrix

PairOfFragments = tuple[int, int]


def read_log(path: Path) -> dict[PairOfFragments, Array]:
    """Poses (4, 4) [m] by (i, j), in file order; each maps points of fragment j into the frame of fragment i.

    Raises InputError naming file and line.
    """
    poses = {}
    for (i, j, place), matrix in _read_blocks(path, 4).items():
        poses[i, j] = pose_from_matrix(matrix, f"{place}: pair {i} {j}")
    return poses


def read_info(path: Path) -> dict[PairOfFragments, Array]:
    """Information matrices (6, 6) by (i, j): order x y z [m], then the quaternion's x y z.

    Raises InputError naming file and line, also where the first entry, the number of correspondences, is not positive.
    """
    found = {}
    for (i, j, place), matrix in _read_blocks(path, 6).items():
        if matrix[0, 0] <= 0.0:
            raise InputError(f"{place}: pair {i} {j}: expected a positive first entry, found {matrix[0, 0]:g}")
        found[i, j] = matrix
    return found


def _read_blocks(path: Path, size: int) -> Mapping[tuple[int, int, str], Array]:
    """Matrices (size, size) by i, j and the place of their header."""
    filled = [(place, line.split()) for place, line in placed_lines(path) if line.strip()]
    blocks: dict[tuple[int, int, str], Array] = {}
    seen: set[PairOfFragments] = set()
    for start in range(0, len(filled), size + 1):
        place, header = filled[start]
        i, j = _fragments(header, place)
        if (i, j) in seen:
            raise InputError(f"{place}: pair {i} {j} stands there twice")
        seen.add((i, j))
        rows = filled[start + 1 : start + 1 + size]
        blocks[i, j, place] = _matrix(rows, size, f"{place}: pair {i} {j}")
    if not blocks:
        raise InputError(f"{path}: expected blocks of a line 'i j n' and {size} rows, found none")
    return blocks


def _fragments(words: list[str], place: str) -> PairOfFragments:
    try:
        i, j, _ = (int(word) for word in words)
    except ValueError:
        raise InputError(f"{place}: expected three whole numbers 'i j n', found {' '.join(words):.60}") from None
    return i, j


def _matrix(rows: list[tuple[str, list[str]]], size: int, block: str) -> Array:
    if len(rows) < size:
        raise InputError(f"{block}: expected {size} rows, found {len(rows)} before the end of the file")
    for place, words in rows:
        if len(words) != size:
            raise InputError(f"{place}: expected {size} numbers, found {len(words)}")
    return np.stack([parse_numbers(words, place) for place, words in rows])
