"""A folder of scans with known poses: `dataset.json`, and `candidates.json` where poses are to be judged.

Paths inside are relative to the folder and may leave it (`../other/scans/a.pcd`). Poses `T_target_source` map source
points into the target frame and are made exact rotations again when read.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from svc_ros.core.config import AUTO, PRESETS, unknown_name
from svc_ros.core.errors import ConfigError, InputError
from svc_ros.core.scan import Array, Scan
from svc_ros.core.se3 import check_pose, nearest_pose
from svc_ros.io.clouds.layout import read_layout

LABELS = ("correct", "wrong", "grey")
_MISSING = object()


@dataclass(frozen=True)
class SuccessThresholds:
    """A pose within both is a success: rotation error [deg], translation error [m]."""

    rotation_deg: float
    translation_m: float


@dataclass(frozen=True, eq=False)
class Pair:
    """Two scans by their paths in the dataset. T_target_source (4, 4) [m] is None for a negative: no pose exists.

    overlap: the smaller direction's share in [0, 1]; distance_m: between the sensors; reliability of the reference:
    high, medium or low ("" where the set does not say); name: of files that belong to the pair, without suffix.
    """

    source: str
    target: str
    T_target_source: Array | None = None
    overlap: float | None = None
    distance_m: float | None = None
    reliability: str = ""
    name: str = ""

    @property
    def file_name(self) -> str:
        """Name of files that belong to the pair: `name`, else the stems of source and target."""
        return self.name or f"{Path(self.source).stem}_{Path(self.target).stem}"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose (4, 4) [m] to accept or reject; `label` is its truth, `origin` how it was made."""

    T_target_source: Array
    label: str
    origin: str = ""


@dataclass(frozen=True, eq=False)
class CandidatePair:
    """Two scans and the poses to judge between them."""

    source: str
    target: str
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False)
class Dataset:
    """What `dataset.json` says. sensor_origin: (3,) [m] in every scan's frame; min_range_m, max_range_m [m].

    correspondences: folder of .npz files, one a pair by its file name, that take the place of FPFH; None: FPFH.
    columns: of .bin and text files, as `read_scan` takes them.
    """

    root: Path
    name: str
    sensor: str
    preset: str
    min_range_m: float
    max_range_m: float
    sensor_origin: Array
    success: SuccessThresholds
    pairs: list[Pair] = field(default_factory=list)
    negatives: list[Pair] = field(default_factory=list)
    candidates: list[CandidatePair] = field(default_factory=list)
    correspondences: Path | None = None
    columns: str = ""

    def read_scan(self, relative: str) -> Scan:
        """Read one scan by its path in the dataset, seen from the dataset's sensor origin."""
        from svc_ros.io.clouds.files import read_scan

        return dataclasses.replace(read_scan(self.root / relative, self.columns), sensor_origin=self.sensor_origin)


def read_dataset(folder: str | Path) -> Dataset:
    """Read `dataset.json` of a folder, and `candidates.json` where it exists.

    Raises InputError naming the file, the key and what was found there. Scans are not opened.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{root}: expected a dataset folder, found {'a file' if root.exists() else 'nothing'}")
    entry = _Entry.of_file(root / "dataset.json")
    preset = entry.text("preset")
    if preset not in (*PRESETS, AUTO):
        raise InputError(f"{entry.place}: {unknown_name('preset', preset, [*PRESETS, AUTO])}")
    success = entry.child("success")
    return Dataset(
        root=root,
        name=entry.text("name"),
        sensor=entry.text("sensor", ""),
        preset=preset,
        min_range_m=entry.number("min_range_m"),
        max_range_m=entry.number("max_range_m"),
        sensor_origin=entry.vector("sensor_origin", (0.0, 0.0, 0.0)),
        success=SuccessThresholds(success.number("rotation_deg"), success.number("translation_m")),
        pairs=[_pair(item) for item in entry.children("pairs")],
        negatives=[Pair(item.text("source"), item.text("target")) for item in entry.children("negatives", [])],
        candidates=_read_candidates(root / "candidates.json"),
        columns=_columns(entry),
    )


def _columns(entry: _Entry) -> str:
    columns = entry.text("columns", "")
    try:
        read_layout(columns or "x y z")
    except ConfigError as error:
        raise InputError(f"{entry.place}: {error}") from None
    return columns


def _pair(entry: _Entry) -> Pair:
    return Pair(
        entry.text("source"),
        entry.text("target"),
        entry.pose("T_target_source"),
        entry.optional_number("overlap"),
        entry.optional_number("distance_m"),
        entry.text("reliability", ""),
    )


def _read_candidates(path: Path) -> list[CandidatePair]:
    if not path.exists():
        return []
    return [
        CandidatePair(
            item.text("source"), item.text("target"), tuple(_candidate(child) for child in item.children("candidates"))
        )
        for item in _Entry.of_file(path).children("pairs")
    ]


def _candidate(entry: _Entry) -> Candidate:
    label = entry.text("label")
    if label not in LABELS:
        raise entry.wrong("label", f"one of {', '.join(LABELS)}", label)
    return Candidate(entry.pose("T_target_source"), label, entry.text("origin", ""))


@dataclass(frozen=True)
class _Entry:
    """A JSON object that knows where it stands, so that every complaint names its file and key."""

    values: Mapping[str, Any]
    place: str
    prefix: str = ""

    @classmethod
    def of_file(cls, path: Path) -> _Entry:
        try:
            values = json.loads(path.read_text("utf-8"))
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        except ValueError as error:  # broken UTF-8 or JSON
            raise InputError(f"{path}: expected JSON: {error}") from None
        return cls.of(values, str(path), "")

    @classmethod
    def of(cls, values: Any, place: str, prefix: str) -> _Entry:
        if not isinstance(values, Mapping):
            what = prefix.rstrip(".") or "the file"
            raise InputError(f"{place}: {what}: expected an object, found {_shown(values)}")
        return cls(values, place, prefix)

    def wrong(self, key: str, expected: str, found: Any) -> InputError:
        return InputError(f"{self.place}: {self.prefix}{key}: expected {expected}, found {_shown(found)}")

    def get(self, key: str, default: Any = _MISSING) -> Any:
        value = self.values.get(key, default)
        if value is _MISSING:
            raise InputError(f"{self.place}: {self.prefix}{key}: missing")
        return value

    def text(self, key: str, default: Any = _MISSING) -> str:
        value = self.get(key, default)
        if not isinstance(value, str):
            raise self.wrong(key, "a text", value)
        return value

    def number(self, key: str) -> float:
        value = self.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.wrong(key, "a finite number", value)
        return float(value)

    def optional_number(self, key: str) -> float | None:
        return None if self.values.get(key) is None else self.number(key)

    def vector(self, key: str, default: Any = _MISSING) -> Array:
        value = self.get(key, default)
        try:
            array = np.array(value, np.float64)
        except (TypeError, ValueError):
            raise self.wrong(key, "three numbers", value) from None
        if array.shape != (3,) or not np.isfinite(array).all():
            raise self.wrong(key, "three numbers", value)
        return array

    def pose(self, key: str) -> Array:
        return nearest_pose(check_pose(self.get(key), f"{self.place}: {self.prefix}{key}"))

    def child(self, key: str) -> _Entry:
        return self.of(self.get(key), self.place, f"{self.prefix}{key}.")

    def children(self, key: str, default: Any = _MISSING) -> list[_Entry]:
        values = self.get(key, default)
        if not isinstance(values, list):
            raise self.wrong(key, "a list", values)
        return [self.of(value, self.place, f"{self.prefix}{key}[{k}].") for k, value in enumerate(values)]


def _shown(value: Any) -> str:
    return f"{value!r:.60}"
