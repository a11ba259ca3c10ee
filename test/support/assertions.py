"""Assertions that several test files share."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from svc_ros.core import se3


def assert_same_pose(T: ArrayLike | None, T_reference: ArrayLike, deg: float, m: float) -> None:
    """Fail where `T` is no pose or lies farther from the reference than `deg` and `m`."""
    assert T is not None, "expected a pose, found None"
    T = np.asarray(T)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
    np.testing.assert_array_equal(T[3], (0, 0, 0, 1))
    angle, distance = se3.pose_error(T, T_reference)
    assert angle <= deg, f"rotation is {angle:.4f} deg from the reference, allowed are {deg}"
    assert distance <= m, f"translation is {distance:.4f} m from the reference, allowed are {m}"


def assert_same_bits(found: ArrayLike, expected: ArrayLike) -> None:
    """Fail unless shape, type and every bit agree."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert (found.shape, found.dtype) == (expected.shape, expected.dtype)
    np.testing.assert_array_equal(found, expected)


def fingerprint(*arrays: np.ndarray) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def assert_given_back(folder: Path) -> None:
    """Fail where this process still holds a file of that folder open; skips without /proc to look at."""
    handles = Path("/proc/self/fd")
    if not handles.is_dir():
        pytest.skip("no /proc to see open files in")
    places = {os.readlink(each) for each in handles.iterdir() if each.is_symlink()}
    held = {Path(place).name for place in places if Path(place).parent == folder}
    assert held <= {"looks.npy"}, held  # that one is mapped: it is free when nobody looks at it any more
