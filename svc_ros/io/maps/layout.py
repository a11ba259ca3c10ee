"""What the files of a map hold (docs/map.md): their names, and the type and shape of one row of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge
from svc_ros.io.maps.arrays import Shape

FORMAT, VERSION = "svc_ros map", 1
DESCRIPTION, CONFIG = "map.json", "config.yaml"

Row = tuple[np.dtype[Any], Shape]

_SCAN = np.dtype(
    [
        ("stamp_ns", "<i8"), ("session", "<i4"), ("sensor_origin", "<f8", (3,)), ("beam_spacing_deg", "<f8"),
        ("first_point", "<i8"), ("num_points", "<i8"), ("first_direction", "<i8"), ("num_directions", "<i8"),
        ("first_cell", "<i8"), ("num_cells", "<i8"), ("first_row", "<i4"), ("num_rows", "<i4"),
        ("cell_size_deg", "<f8", (2,)), ("cell_ratios", "<f8", (2,)),
    ]
)  # fmt: skip
_EDGE = np.dtype(
    [("source", "<i4"), ("target", "<i4"), ("T_target_source", "<f8", (4, 4)), ("covariance", "<f8", (6, 6))]
)
_VECTOR: Row = np.dtype("<f8"), (3,)
_RANGE: Row = np.dtype("<f4"), ()

OF_SCANS: dict[str, Row] = {  # written keyframe by keyframe
    "points": _VECTOR,
    "normals": _VECTOR,
    "free_directions": _VECTOR,
    "range_near": _RANGE,
    "range_far": _RANGE,
    "scans": (_SCAN, ()),
    "looks": (np.dtype("<c8"), (20, 61)),
}
OF_GRAPH: dict[str, Row] = {  # written in the end
    "poses": (np.dtype("<f8"), (4, 4)),
    "covariances": (np.dtype("<f8"), (6, 6)),
    "edges": (_EDGE, ()),
}
ARRAYS = {**OF_SCANS, **OF_GRAPH}


@dataclass(frozen=True)
class Session:
    """One run that a map was made of. source: what its scans came from, the name of a bag; frame_id: of its clouds."""

    source: str
    frame_id: str


@dataclass(frozen=True, eq=False)
class MapGraph:
    """Where the keyframes of a map stand.

    poses: (N, 4, 4) [m], T_map_scan; covariances: (N, 6, 6) of their errors, as the optimiser tells them; edges: what
    was measured between keyframes, from which all of it can be optimised again.
    """

    poses: Array
    covariances: Array
    edges: Sequence[GraphEdge]


def file_name(array: str) -> str:
    """Of the file that holds an array."""
    return f"{array}.npy"
