"""Reference poses of drives: what the positioning says, made exact by ICP and kept on disk."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.core.scans.preprocess import thin_on_voxel_grid
from svc_ros.io.datasets import Pair
from svc_ros.io.suites import Suite
from svc_ros.io.transform_files import read_transform

VOXEL_SIZE_M, MAX_DISTANCE_M, MAX_ROUNDS = 0.05, 0.2, 200  # as the published evaluations on KITTI refine
_SAME = 1e-6  # change of the inlier share and of their RMSE at which ICP ends


def refined_reference(suite: Suite, pair: Pair) -> Array:
    """T_target_source (4, 4) [m] of a pair: read from the folder `suite.refined`, or made there on first use.

    Files are those of FCGF and GeoTransformer: a 4x4 .npy by the pair's name. Raises InputError naming the file.
    """
    assert suite.refined is not None
    assert pair.T_target_source is not None
    path = suite.refined / f"{pair.file_name}.npy"
    if not path.is_file():
        scans = (suite.read_scan(scan) for scan in (pair.source, pair.target))
        source, target = (thin_on_voxel_grid(scan.points, VOXEL_SIZE_M) for scan in scans)
        _write(path, refine_point_to_point(source, target, pair.T_target_source))
    return read_transform(path)


def refine_point_to_point(source: Array, target: Array, T_target_source: Array) -> Array:
    """ICP from a pose (4, 4) that is nearly right; source (N, 3), target (M, 3) [m].

    Pairs of nearest points within 0.2 m, at most 200 rounds, in a fixed order: the same bits wherever it runs. The
    pose that is given is returned where fewer than three points have a partner.
    """
    tree = cKDTree(target)
    T, before = T_target_source, (-1.0, -1.0)
    for _ in range(MAX_ROUNDS):
        found = tree.query(se3.apply(T, source), distance_upper_bound=MAX_DISTANCE_M)
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        near = np.flatnonzero(np.isfinite(distance))
        if len(near) < 3:
            return T
        now = (len(near) / len(source), float(np.sqrt(np.mean(np.square(distance[near])))))
        if max(abs(a - b) for a, b in zip(now, before, strict=True)) < _SAME:
            return T
        poses, valid = se3.kabsch(source[near][None], target[nearest[near]][None], np.ones((1, len(near))))
        if not valid[0]:
            return T
        T, before = poses[0], now
    return T


def _write(path: Path, T: Array) -> None:
    """Another process may make the same file at the same moment: each writes its own and puts it there whole."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.npy")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(temporary, T)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(
            f"{path}: the refined reference cannot be written: {error.strerror} (--refined names another folder)"
        ) from None
