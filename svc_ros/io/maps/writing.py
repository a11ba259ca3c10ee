"""Writes the folder of a map, keyframe by keyframe."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import svc_ros
from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.range_image import rows_of
from svc_ros.core.scan import PreparedScan
from svc_ros.io.config_yaml import config_to_yaml
from svc_ros.io.g2o import GraphEdge
from svc_ros.io.maps.arrays import ArrayWriter
from svc_ros.io.maps.layout import (
    ARRAYS,
    CONFIG,
    DESCRIPTION,
    FORMAT,
    OF_GRAPH,
    OF_SCANS,
    VERSION,
    MapGraph,
    Session,
    file_name,
)


class MapWriter:
    """Writes a map into an existing folder, which is one after `finish`. Raises InputError; `close` it in the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = {name: ArrayWriter(folder / file_name(name), *row) for name, row in OF_SCANS.items()}

    def __len__(self) -> int:
        return self._files["scans"].num_rows

    def add(self, scan: PreparedScan, look: NDArray[np.complex64], session: int) -> None:
        """Write the next keyframe. look: (20, 61), as places are searched for; session: the number of its run."""
        files, image = self._files, scan.range_image
        if image is None:
            raise InputError(f"map: expected a range image with the scan at {scan.stamp_ns} ns, found none")
        row = np.zeros(1, ARRAYS["scans"][0])
        values = {
            "stamp_ns": scan.stamp_ns, "session": session, "sensor_origin": scan.sensor_origin,
            "beam_spacing_deg": scan.beam_spacing_deg,
            "first_point": files["points"].num_rows, "num_points": len(scan),
            "first_direction": files["free_directions"].num_rows, "num_directions": len(scan.free_directions),
            "first_cell": files["range_near"].num_rows, "num_cells": len(image.near),
            "cell_size_deg": image.size_deg, "cell_ratios": (image.dense_ratio, image.seen_ratio),
        }  # fmt: skip
        for name, value in values.items():
            row[name] = value
        row["first_row"], row["num_rows"] = rows_of(image)
        arrays: tuple[NDArray[Any], ...] = (
            scan.points, scan.normals, scan.free_directions, image.near, image.far, row, look,
        )  # fmt: skip
        for name, rows in zip(OF_SCANS, arrays, strict=True):
            files[name].append(rows)

    def finish(self, graph: MapGraph, sessions: Sequence[Session], config: Config) -> None:
        """Write what is known of all keyframes together; the description, which makes it a map, comes last.

        sessions: the runs by number; config: that all keyframes were made with.
        """
        arrays: dict[str, NDArray[Any]] = {
            "poses": graph.poses, "covariances": graph.covariances, "edges": _rows_of(graph.edges)
        }  # fmt: skip
        for name, rows in arrays.items():
            self._files[name] = ArrayWriter(self._folder / file_name(name), *OF_GRAPH[name])
            self._files[name].append(rows)
        self.close()
        description = {
            "format": FORMAT, "version": VERSION, "svc_ros": svc_ros.__version__,
            "rows": {name: self._files[name].num_rows for name in ARRAYS},
            "sessions": [dataclasses.asdict(session) for session in sessions],
            "preprocess": dataclasses.asdict(config.preprocess),
        }  # fmt: skip
        texts = {CONFIG: config_to_yaml(config), DESCRIPTION: json.dumps(description, indent=2) + "\n"}
        for name, text in texts.items():
            try:
                (self._folder / name).write_text(text, "utf-8")
            except OSError as error:
                raise InputError(f"{self._folder / name}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close all files, whole or not; twice does no harm."""
        for file in self._files.values():
            file.close()


def _rows_of(edges: Sequence[GraphEdge]) -> NDArray[np.void]:
    rows = np.zeros(len(edges), ARRAYS["edges"][0])
    for row, edge in zip(rows, edges, strict=True):
        row["source"], row["target"] = edge.source, edge.target
        row["T_target_source"], row["covariance"] = edge.T_target_source, edge.covariance
    return rows
