"""Trajectories as text: TUM (`t x y z qx qy qz qw`) and KITTI (the 12 numbers of a 3x4 matrix a line).

A pose maps the moving frame into the fixed one: p_world = pose p_sensor. Stamps are read as decimals, exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import IndexArray, frozen_array
from svc_ros.core.se3 import Array
from svc_ros.io.pose_text import parse_numbers, placed_lines, pose_from_matrix, pose_from_values, text_of_numbers
from svc_ros.io.stamps import ns_from_text, text_from_ns
from svc_ros.io.transforms import interpolate_poses

_SPAN_TOLERANCE_NS = 1_000_000  # recorders that pass a stamp through float64 seconds move it by up to 240 ns


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses over time: stamps_ns (N,) strictly increasing, poses (N, 4, 4) [m], world <- sensor."""

    stamps_ns: IndexArray
    poses: Array

    def __post_init__(self) -> None:
        stamps = frozen_array(self.stamps_ns, np.int64, "Trajectory.stamps_ns", (None,))
        object.__setattr__(self, "stamps_ns", stamps)
        object.__setattr__(self, "poses", frozen_array(self.poses, float, "Trajectory.poses", (len(stamps), 4, 4)))
        late = np.flatnonzero(np.diff(stamps) <= 0)
        if len(late):
            first, second = (text_from_ns(int(stamps[late[0] + k])) for k in (0, 1))
            raise InputError(f"Trajectory.stamps_ns: expected increasing stamps, found {first} s before {second} s")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def at(self, stamp_ns: int, tolerance_ns: int = _SPAN_TOLERANCE_NS) -> Array:
        """Pose (4, 4) at a stamp, interpolated; the first or last pose up to `tolerance_ns` (1 ms) outside the span.

        Raises TransformUnavailableError naming the stamp and the span.
        """
        if not len(self):
            raise TransformUnavailableError(f"trajectory: no pose at {text_from_ns(stamp_ns)} s: it is empty")
        first, last = int(self.stamps_ns[0]), int(self.stamps_ns[-1])
        if not first - tolerance_ns <= stamp_ns <= last + tolerance_ns:
            raise TransformUnavailableError(
                f"trajectory: no pose at {text_from_ns(stamp_ns)} s: it spans {text_from_ns(first)} s "
                f"to {text_from_ns(last)} s"
            )
        stamp_ns = min(max(stamp_ns, first), last)
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if self.stamps_ns[after] == stamp_ns:
            return np.array(self.poses[after])
        before_ns, after_ns = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return interpolate_poses(self.poses[after - 1], self.poses[after], share)


def read_tum(path: str | Path) -> Trajectory:
    """Read `t x y z qx qy qz qw` lines ([s], [m], unit quaternion); blank lines and `#` comments are skipped.

    Raises InputError naming file and line for a wrong count of values, a value that is no number, a quaternion
    whose length is off by more than 1e-3, and a stamp that does not increase.
    """
    stamps: list[int] = []
    poses: list[Array] = []
    for place, words in _lines(path, 8, "t x y z qx qy qz qw"):
        try:
            stamp = ns_from_text(words[0])
        except InputError as error:
            raise InputError(f"{place}: {error}") from None
        if stamps and stamp <= stamps[-1]:
            raise InputError(f"{place}: expected a stamp after {text_from_ns(stamps[-1])} s, found {words[0]} s")
        stamps.append(stamp)
        poses.append(pose_from_values(parse_numbers(words[1:], place), place))
    return Trajectory(np.array(stamps, np.int64), np.stack(poses))


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM lines: stamps with nine decimals, poses with twelve digits."""
    quaternions = Rotation.from_matrix(trajectory.poses[:, :3, :3]).as_quat() if len(trajectory) else np.zeros((0, 4))
    rows = np.hstack([trajectory.poses[:, :3, 3], quaternions])
    lines = [
        f"{text_from_ns(int(stamp))} {text_of_numbers(row)}"
        for stamp, row in zip(trajectory.stamps_ns, rows, strict=True)
    ]
    _write_lines(path, lines)


def read_kitti(path: str | Path) -> Array:
    """Read poses (N, 4, 4) [m] from lines of 12 numbers, the rows of a 3x4 matrix; the format has no stamps.

    Raises InputError naming file and line for a wrong count, a value that is no number, and a block that is no
    rotation. What rounding to text did to a rotation is undone.
    """
    poses = []
    for place, words in _lines(path, 12, "the 12 numbers of a 3x4 matrix"):
        poses.append(pose_from_matrix(parse_numbers(words, place), place))
    return np.stack(poses)


def write_kitti(path: str | Path, poses: Array) -> None:
    """Write poses (N, 4, 4) [m] as lines of 12 numbers."""
    checked = frozen_array(poses, float, "poses", (None, 4, 4))
    _write_lines(path, [text_of_numbers(T[:3].ravel()) for T in checked])


def _lines(path: str | Path, num_words: int, form: str) -> Iterator[tuple[str, list[str]]]:
    """Yield (file:line, words) of every line that holds data."""
    found = False
    for place, line in placed_lines(path, " as a trajectory"):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != num_words:
            raise InputError(f"{place}: expected {form}, found {len(words)} values")
        found = True
        yield place, words
    if not found:
        raise InputError(f"{path}: expected lines of {form}, found none")


def _write_lines(path: str | Path, lines: list[str]) -> None:
    try:
        Path(path).write_text("".join(line + "\n" for line in lines), "utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
