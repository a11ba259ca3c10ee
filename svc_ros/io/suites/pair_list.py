"""Pair lists as the authors of benchmarks publish them: a line or a row names two scans and, mostly, their pose.

Text (LiDAR-Registration-Benchmark, G3Reg): a heading, then `seq i seq_db j`, the 16 numbers of the 4x4 pose that maps
scan i into scan j, and an overlap in some. Arrays (UMERegRobust, GCL): `NAME_metadata.npy`, rows of sequence, source,
target, and `NAME_gt_tforms.npy`, (N, 4, 4) in the same order, each mapping source into target.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import rotation_angle_deg
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_matrix
from svc_ros.io.suites.suite import SuitePair, pose_from_drive

ARRAY_FOLDERS = ("", "metadata", "config")
_DISTANCE_STEP_M, _ANGLE_STEP_DEG, _ALMOST_HALF_TURN_DEG = 10, 30, 179.9
_HEADING, _NUMBERS = "seq", "seq i seq_db j and the 16 numbers of a 4x4 matrix"


@dataclass(frozen=True, eq=False)
class ListedPair:
    """Two scans of a list. place: its file and line, or row counted from 0; sequence: as the list names it.

    source, target: frames; T_target_source (4, 4) [m] and overlap in [0, 1]: None where the list has none.
    """

    place: str
    sequence: str
    source: int
    target: int
    T_target_source: Array | None = None
    overlap: float | None = None


def read_text_list(path: Path) -> list[ListedPair]:
    """Pairs of a text list in file order. Raises InputError naming file and line."""
    rows = [(place, line.split()) for place, line in placed_lines(path)]
    pairs = [_pair_of_line(words, place) for place, words in rows if words and words[0] != _HEADING]
    if not pairs:
        raise InputError(f"{path}: expected lines of {_NUMBERS}, found none")
    return pairs


def _pair_of_line(words: list[str], place: str) -> ListedPair:
    if len(words) not in (20, 21):
        raise InputError(f"{place}: expected {_NUMBERS} (an overlap may follow), found {len(words)} values")
    if not all(word.isdecimal() for word in words[:4]):
        raise InputError(f"{place}: expected four whole numbers 'seq i seq_db j', found {' '.join(words[:4])}")
    sequence, source, sequence_of_target, target = (int(word) for word in words[:4])
    if sequence != sequence_of_target:
        raise InputError(f"{place}: expected both scans in one sequence, found {sequence} and {sequence_of_target}")
    values = parse_numbers(words[4:], place)
    T = pose_from_matrix(values[:16].reshape(4, 4), place)
    return ListedPair(place, str(sequence), source, target, T, float(values[16]) if len(values) > 16 else None)


def read_array_list(root: Path, name: str, others: Sequence[str] = ()) -> list[ListedPair]:
    """Pairs of `NAME_metadata.npy`, with the poses of `NAME_gt_tforms.npy` where that lies beside it.

    others: names of further lists, looked for after that one; they come without poses. Raises InputError naming the
    file and the row.
    """
    wanted = f"{name}_metadata.npy"
    path = find_list(root, ARRAY_FOLDERS, (wanted, *others))
    rows = read_array(path)
    if rows.ndim != 2 or rows.shape[1] != 3 or rows.dtype.kind not in "iuU" or not len(rows):
        raise InputError(
            f"{path}: expected rows of sequence, source, target in whole numbers or text, found {_shown(rows)}"
        )
    poses = _poses_beside(path, name, len(rows)) if path.name == wanted else None
    return [_pair_of_row(row, f"{path}: row {k}", None if poses is None else poses[k]) for k, row in enumerate(rows)]


def find_list(root: Path, folders: Iterable[str], names: Sequence[str]) -> Path:
    """The first of these names in the first of these folders of the root that has one. Raises InputError."""
    places = [Path(folder, name) for folder in folders for name in names]
    found = next((root / place for place in places if (root / place).is_file()), None)
    if found is None:
        raise InputError(f"{root}: expected the pair list in one of {', '.join(map(str, places))}, found none")
    return found


def pose_between(pair: ListedPair, poses: Array, origin: Path) -> Array:
    """T_target_source (4, 4) [m] of a pair by the poses (N, 4, 4), world <- scan, of its sequence.

    Raises InputError where there are none of these frames; origin: the file of the poses.
    """
    last = max(pair.source, pair.target)
    if last >= len(poses):
        raise InputError(f"{pair.place}: expected frames below {len(poses)}, the poses in {origin}, found {last}")
    return pose_from_drive(poses[pair.source], poses[pair.target])


def suite_pair(pair: ListedPair, scans: Sequence[Path], T_target_source: Array, root: Path, name: str) -> SuitePair:
    """The pair of a suite; scans: the files of source and target. Raises InputError where one is missing."""
    missing = next((path for path in scans if not path.is_file()), None)
    if missing is not None:
        raise InputError(f"{pair.place}: expected the scan {missing}, found none")
    source, target = (os.path.relpath(path, root) for path in scans)
    return SuitePair(
        source,
        target,
        T_target_source,
        overlap=pair.overlap,
        distance_m=float(np.linalg.norm(T_target_source[:3, 3])),
        name=name,
        indices=(pair.target, pair.source),
    )


def in_groups(pairs: Iterable[SuitePair], range_of: Callable[[Array], str]) -> list[SuitePair]:
    """Pairs in groups that their references name, the smallest range first; within one the order is kept."""
    grouped = []
    for pair in pairs:
        assert pair.T_target_source is not None
        grouped.append(dataclasses.replace(pair, group=range_of(pair.T_target_source)))
    return sorted(grouped, key=lambda pair: int(pair.group.partition("-")[0]))


def distance_range(T: Array) -> str:
    """The ten metres in which the length of a pose (4, 4) [m] lies: `10-20 m`."""
    return _range_of(float(np.linalg.norm(T[:3, 3])), _DISTANCE_STEP_M, "m")


def angle_range(T: Array) -> str:
    """The thirty degrees in which the angle of a pose (4, 4) lies: `30-60 deg`; half a turn is in the last ones."""
    return _range_of(min(float(rotation_angle_deg(T[:3, :3])), _ALMOST_HALF_TURN_DEG), _ANGLE_STEP_DEG, "deg")


def _range_of(value: float, step: int, unit: str) -> str:
    low = step * int(value // step)
    return f"{low}-{low + step} {unit}"


def _poses_beside(path: Path, name: str, num_pairs: int) -> Array | None:
    """Poses (N, 4, 4) [m] of the list, as stored; None where there are none."""
    path = path.with_name(f"{name}_gt_tforms.npy")
    if not path.is_file():
        return None
    poses = read_array(path)
    if poses.shape != (num_pairs, 4, 4) or poses.dtype.kind not in "iuf":
        raise InputError(f"{path}: expected a 4x4 matrix for each of the {num_pairs} pairs, found {_shown(poses)}")
    return np.asarray(poses, np.float64)


def _pair_of_row(row: NDArray[Any], place: str, pose: Array | None) -> ListedPair:
    sequence, *frames = map(str, row.tolist())
    if not sequence or not all(frame.isdecimal() for frame in frames):
        raise InputError(f"{place}: expected a sequence and two frames, found {' '.join(map(str, row)):.80}")
    T = None if pose is None else pose_from_matrix(pose, f"{place}: its pose")
    return ListedPair(place, sequence, int(frames[0]), int(frames[1]), T)


def read_array(path: Path) -> NDArray[Any]:
    """One .npy array of numbers or text. Raises InputError naming the file; pickles are refused."""
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(
            f"{path}: expected a .npy array of numbers or text (pickles are never loaded): {error}"
        ) from None
    if not isinstance(array, np.ndarray):
        raise InputError(f"{path}: expected a single array, found an archive")
    return array


def _shown(array: NDArray[Any]) -> str:
    return f"{array.dtype} of shape {array.shape}"
