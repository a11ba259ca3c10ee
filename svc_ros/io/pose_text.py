"""Numbers and poses as words of a text file, whichever format it has."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import make_pose

_UNIT_TOLERANCE = 1e-3  # of a quaternion's length; files print three digits and more


def parse_numbers(words: list[str], place: str) -> Array:
    """The words as finite numbers (N,); raises InputError beginning with `place`."""
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputError(f"{place}: expected numbers, {error}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{place}: expected finite numbers, found {' '.join(words):.120}")
    return values


def pose_from_values(values: Array, place: str) -> Array:
    """Pose (4, 4) of x y z [m] qx qy qz qw; raises InputError if the quaternion's length is off by more than 1e-3."""
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise InputError(f"{place}: expected a quaternion of length 1, found length {length:.6g}")
    return make_pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def text_of_numbers(values: Iterable[float]) -> str:
    """Twelve digits of each, parted by blanks."""
    return " ".join(f"{value:.12g}" for value in values)
