"""Lines of a text file, and numbers and poses as words of it, whichever format it has."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import check_pose, make_pose, nearest_pose

_UNIT_TOLERANCE = 1e-3  # of a quaternion's length; files print three digits and more


def placed_lines(path: str | Path, as_what: str = "") -> list[tuple[str, str]]:
    """(file:line, text) of every line. Raises InputError naming the file; as_what: added to what it says."""
    try:
        text = Path(path).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        cause = getattr(error, "strerror", None) or "it is not a text file"
        raise InputError(f"{path}: cannot be read{as_what}: {cause}") from None
    return [(f"{path}:{number}", line) for number, line in enumerate(text.splitlines(), 1)]


def parse_numbers(words: list[str], place: str) -> Array:
    """The words as finite numbers (N,); raises InputError beginning with `place`."""
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{place}: expected numbers, {error}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{place}: expected finite numbers, found {' '.join(words):.120}")
    return values


def pose_from_matrix(numbers: ArrayLike, place: str) -> Array:
    """Pose (4, 4) of a 4x4 matrix, or of the 12 numbers of a 3x4 one; what rounding to text did to it is undone.

    Raises InputError, beginning with `place`, for what is no rigid motion.
    """
    matrix = np.asarray(numbers)
    if matrix.size == 12:
        matrix = np.vstack([matrix.reshape(3, 4), (0.0, 0.0, 0.0, 1.0)])
    return nearest_pose(check_pose(matrix, place))


def pose_from_values(values: Array, place: str) -> Array:
    """Pose (4, 4) of x y z [m] qx qy qz qw; raises InputError if the quaternion's length is off by more than 1e-3."""
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise InputError(f"{place}: expected a quaternion of length 1, found length {length:.6g}")
    return make_pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def text_of_numbers(values: Iterable[float]) -> str:
    """Twelve digits of each, parted by blanks."""
    return " ".join(f"{value:.12g}" for value in values)
