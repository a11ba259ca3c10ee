"""One transform from a file, in the forms in which people keep one."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.pose_text import pose_from_matrix

_JSON_KEYS = ("T_target_source", "best_candidate")


def read_transform(path: str | Path) -> Array:
    """Read a pose (4, 4) that maps source points into the target frame.

    Understood are: text of 16 numbers (4x4, row by row) or 12 (3x4, a KITTI row), separated by blanks or commas, `#`
    starting a comment; JSON, either nested lists or a result of `register`, whose `T_target_source` is taken, or its
    `best_candidate` where nothing was accepted; .npy of any of these shapes. The rotation is projected onto the
    nearest exact one, which undoes the rounding of printed digits. Raises InputError naming the file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: transform file not found")
    numbers = _read_npy(path) if path.suffix.lower() == ".npy" else _read_text(path)
    return pose_from_matrix(_as_matrix(numbers, path), str(path))


def _read_npy(path: Path) -> ArrayLike:
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (ValueError, TypeError, OSError, EOFError) as error:
        raise InputError(f"{path}: expected a .npy array of numbers: {error}") from None


def _read_text(path: Path) -> ArrayLike:
    try:
        text = path.read_text(encoding="utf-8").strip()
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected text, JSON or .npy, found binary data") from None
    if text.startswith("{") or path.suffix.lower() == ".json":
        return _read_json(text, path)
    words = re.sub(r"#.*", " ", text)
    try:
        return [float(word) for word in re.split(r"[\s,;\[\]]+", words) if word]
    except ValueError as error:
        raise InputError(f"{path}: expected 16 or 12 numbers, found text: {error}") from None


def _read_json(text: str, path: Path) -> ArrayLike:
    try:
        value: Any = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    if isinstance(value, dict):
        found = [value[key] for key in _JSON_KEYS if value.get(key) is not None]
        if not found:
            raise InputError(f"{path}: expected a pose under {' or '.join(_JSON_KEYS)}, found none")
        value = found[0]
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{path}: expected a 4x4 matrix of numbers in the JSON") from None


def _as_matrix(numbers: ArrayLike, path: Path) -> Array:
    flat = np.asarray(numbers, np.float64).ravel()
    if len(flat) not in (12, 16):
        raise InputError(f"{path}: expected 16 numbers (4x4) or 12 (3x4), found {len(flat)}")
    return flat.reshape(-1, 4)
