"""Correspondences that another program computed, one .npz a pair of scans.

Keys: `source_points` and `target_points`, both (C, 3) [m], row c of each being the same place, in the frame of its own
scan; optionally `distance` (C,), smaller is better. GeoTransformer's own files are understood as they are:
`src_corr_points`, `ref_corr_points` and `corr_scores` (C,), larger is better.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Correspondences, frozen_array

_KEYS = (("source_points", "target_points"), ("src_corr_points", "ref_corr_points"))
_DISTANCE, _SCORE = "distance", "corr_scores"


def read_correspondences(path: str | Path) -> Correspondences:
    """Read one .npz. Raises InputError naming the file, the key and what was expected there; pickles are refused."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file of correspondences")
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise InputError(f"{path}: expected an .npz archive, found a single array")
        with loaded as archive:
            return _from_arrays({key: archive[key] for key in archive.files if key in _known()}, archive.files, path)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: expected an .npz archive of numbers: {error}") from None


def write_correspondences(path: str | Path, source_points: ArrayLike, target_points: ArrayLike) -> None:
    """Write (C, 3) and (C, 3) [m] so that `read_correspondences` reads them; folders are made."""
    checked = Correspondences.from_points(source_points, target_points)
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, source_points=checked.source_points, target_points=checked.target_points)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _known() -> set[str]:
    return {key for names in _KEYS for key in names} | {_DISTANCE, _SCORE}


def _from_arrays(arrays: Mapping[str, Any], names: list[str], path: Path) -> Correspondences:
    keys = next((pair for pair in _KEYS if set(pair) <= set(arrays)), None)
    if keys is None:
        wanted = " or ".join(f"{source} and {target}" for source, target in _KEYS)
        raise InputError(f"{path}: expected the keys {wanted}, found {', '.join(names) or 'none':.200}")
    source = frozen_array(arrays[keys[0]], np.float64, f"{path}: {keys[0]}", (None, 3))
    target = frozen_array(arrays[keys[1]], np.float64, f"{path}: {keys[1]}", (len(source), 3))
    if _DISTANCE in arrays:
        distance = arrays[_DISTANCE]
    elif _SCORE in arrays:
        distance = -np.asarray(arrays[_SCORE], np.float64)
    else:
        distance = np.zeros(len(source))
    return Correspondences(source, target, frozen_array(distance, np.float64, f"{path}: {_DISTANCE}", (len(source),)))
