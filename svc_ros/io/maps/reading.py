"""Reads the folder of a map: what is small at once, scans when they are asked for."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.config import Config, PreprocessConfig
from svc_ros.core.errors import InputError
from svc_ros.core.range_image import restore_range_image
from svc_ros.core.scan import IndexArray, PreparedScan
from svc_ros.io.config_yaml import read_config
from svc_ros.io.g2o import GraphEdge
from svc_ros.io.maps.arrays import ArrayFile
from svc_ros.io.maps.layout import ARRAYS, CONFIG, DESCRIPTION, FORMAT, VERSION, MapGraph, Session, file_name

_KEYFRAME_ARRAYS = ("looks", "poses", "covariances")  # as many rows as there are scans
_PARTS = (("first_point", "num_points", ("points", "normals")),
          ("first_direction", "num_directions", ("free_directions",)),
          ("first_cell", "num_cells", ("range_near", "range_far")))  # fmt: skip
_ROUNDING = 1e-6  # of a rotation


class MapFiles:
    """The files of a map, open and checked; safe from one thread at a time.

    config: that the keyframes were made with; sessions: the runs by number; graph: where the keyframes stand;
    stamps_ns, session_of: (N,) of every keyframe; looks: (N, 20, 61) complex64, mapped.
    Raises InputError that names the file, what was expected and what was found.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not folder.is_dir():
            raise InputError(f"{folder}: expected the folder of a map, found {'a file' if folder.exists() else 'none'}")
        rows, self.sessions, made_with = _read_description(folder / DESCRIPTION)
        self.config = _read_config(folder / CONFIG, made_with)
        self._files: dict[str, ArrayFile] = {}
        try:
            for name, row in ARRAYS.items():
                self._files[name] = ArrayFile(folder / file_name(name), *row, rows[name])
            self._read(rows)
        except BaseException:
            self.close()
            raise

    def _read(self, rows: dict[str, int]) -> None:
        for name in _KEYFRAME_ARRAYS:
            if rows[name] != rows["scans"]:
                raise InputError(f"{self.folder / DESCRIPTION}: expected {rows['scans']} {name}, found {rows[name]}")
        self._scans, edges = self._files["scans"].rows(), self._files["edges"].rows()
        for first, num, names in _PARTS:
            ends = [self._scans[first], self._scans[num], self._scans[first] + self._scans[num]]
            for name in names:
                self._check_numbers("scans", ends, f"rows of {file_name(name)}", rows[name])
        self._check_numbers("scans", self._scans["session"], "sessions", len(self.sessions) - 1)
        self._check_numbers("edges", [edges["source"], edges["target"]], "keyframes", rows["scans"] - 1)
        poses, covariances = self._files["poses"].rows(), self._files["covariances"].rows()
        with np.errstate(over="ignore", invalid="ignore"):  # of what is no rotation
            turns = poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1)
        self._check_rows("poses", np.isfinite(poses).all((1, 2)) & (np.abs(turns - np.eye(3)) < _ROUNDING).all((1, 2)))
        self._check_rows("covariances", np.isfinite(covariances).all((1, 2)))
        self.graph = MapGraph(poses, covariances, [self._edge(row) for row in edges])
        self.stamps_ns: IndexArray = self._scans["stamp_ns"].astype(np.int64)
        self.session_of: IndexArray = self._scans["session"].astype(np.int64)
        self.looks: NDArray[np.complex64] = self._files["looks"].mapped()

    def _edge(self, row: Any) -> GraphEdge:
        try:
            return GraphEdge(int(row["source"]), int(row["target"]), row["T_target_source"], row["covariance"])
        except InputError as error:
            raise InputError(f"{self.folder / file_name('edges')}: {error}") from None

    def _check_numbers(self, name: str, found: ArrayLike, of_what: str, last: int) -> None:
        numbers = np.asarray(found)
        wrong = numbers[(numbers < 0) | (numbers > last)]
        if len(wrong):
            raise InputError(
                f"{self.folder / file_name(name)}: expected numbers of {of_what} from 0 to {last}, found {wrong[0]}"
            )

    def _check_rows(self, name: str, is_sound: NDArray[np.bool_]) -> None:
        if not is_sound.all():
            row = int(np.argmin(is_sound))
            raise InputError(f"{self.folder / file_name(name)}: expected {name}, found something else in row {row}")

    def scan(self, index: int) -> PreparedScan:
        """A keyframe's scan, bit for bit as it was written."""
        row = self._scans[index]
        session = self.sessions[row["session"]]
        points, normals, directions, near, far = (
            self._files[name].rows(int(row[first]), int(row[num])) for first, num, names in _PARTS for name in names
        )
        try:
            image = restore_range_image(
                near, far, _pair(row["cell_size_deg"]), (int(row["first_row"]), int(row["num_rows"])),
                _pair(row["cell_ratios"]),
            )  # fmt: skip
            return PreparedScan(
                points, normals, np.array(row["sensor_origin"]), self.config.preprocess.voxel_size_m,
                int(row["stamp_ns"]), session.frame_id, float(row["beam_spacing_deg"]), directions, image,
            )  # fmt: skip
        except InputError as error:
            raise InputError(f"{self.folder}: keyframe {index}: {error}") from None

    def close(self) -> None:
        """Give the files back."""
        for file in self._files.values():
            file.close()


def _pair(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _read_description(path: Path) -> tuple[dict[str, int], list[Session], dict[str, Any]]:
    """Numbers of rows by array, the sessions, and the preprocessing of the keyframes."""
    try:
        found = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: the description of a map cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: expected JSON, found something else: {error}") from None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise InputError(f"{path}: expected the description of a map, found another one ('format' is not {FORMAT!r})")
    if found.get("version") != VERSION:
        raise InputError(f"{path}: expected version {VERSION} of the format, found {found.get('version')!r}")
    try:
        rows = {name: int(found["rows"][name]) for name in ARRAYS}
        sessions = [Session(str(each["source"]), str(each["frame_id"])) for each in found["sessions"]]
        return rows, sessions, dict(found["preprocess"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: expected rows, sessions and preprocess, found none or others: {error}") from None


def _read_config(path: Path, made_with: dict[str, Any]) -> Config:
    """The configuration, which may differ from the one of the keyframes in what they do not depend on."""
    config = read_config(path, Config())
    check_preprocess(path, config.preprocess, made_with)
    return config


def check_preprocess(place: Path, found: PreprocessConfig, made_with: dict[str, Any]) -> None:
    """Raise InputError unless scans are prepared as the keyframes of a map were."""
    for name, value in dataclasses.asdict(found).items():
        if value != made_with.get(name):
            raise InputError(
                f"{place}: expected preprocess.{name} {made_with.get(name)}, which the keyframes were made with, "
                f"found {value}"
            )
