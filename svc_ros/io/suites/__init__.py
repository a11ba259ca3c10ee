"""Benchmarks of the field in the layouts in which their authors distribute them. Nothing is downloaded."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from svc_ros.core.config import unknown_name
from svc_ros.core.errors import InputError
from svc_ros.io.suites.kitti import read_kitti
from svc_ros.io.suites.kitti_lists import read_kitti_loops, read_lokitti, read_rotkitti
from svc_ros.io.suites.mulran import read_mulran
from svc_ros.io.suites.nuscenes import read_lonuscenes, read_rotnuscenes
from svc_ros.io.suites.suite import Criterion, Suite, SuitePair
from svc_ros.io.suites.threedmatch import read_3dlomatch, read_3dmatch

__all__ = ["SUITES", "Criterion", "Suite", "SuitePair", "read_suite"]

_READERS: dict[str, Callable[[Path], Suite]] = {
    "kitti": read_kitti,
    "kitti-loops": read_kitti_loops,
    "lokitti": read_lokitti,
    "rotkitti": read_rotkitti,
    "3dmatch": read_3dmatch,
    "3dlomatch": read_3dlomatch,
    "mulran": read_mulran,
    "lonuscenes": read_lonuscenes,
    "rotnuscenes": read_rotnuscenes,
}
SUITES = tuple(_READERS)


def read_suite(name: str, folder: str | Path, refined: Path | None = None) -> Suite:
    """Read the pair list of a benchmark; scans are not opened.

    `refined` is the folder that keeps refined reference poses (kitti, mulran); the default is `icp` in the data
    folder. Raises InputError for an unknown name and for a folder that is laid out otherwise.
    """
    if name not in _READERS:
        raise InputError(unknown_name("suite", name, list(SUITES)))
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{root}: expected a folder, found {'a file' if root.exists() else 'nothing'}")
    suite = _READERS[name](root)
    return suite if refined is None or suite.refined is None else dataclasses.replace(suite, refined=refined)
