"""Which sensor a set was taken with: sets that are left out together, so that a fit saw no recording of it, and kinds
of sensors by what a set says of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from lib.evidence import Row
from svc_ros.core.scan import Array

SENSORS = {  # by the name of the set; a set that is not named here is a sensor of its own
    "hdl64_kitti_a": "HDL-64E", "hdl64_kitti_05_loop": "HDL-64E", "hdl64_city": "HDL-64E",
    "os1_64_seosan": "OS1-64", "os1_64_highway": "OS1-64", "os1_64_yard": "OS1-64", "os0_64_walk": "OS0-64",
    "vlp16_hand_held": "VLP-16", "solid_state_yard": "solid state", "livox_dense": "Livox",
    "tripod_scanner_flat": "tripod scanner", "rgbd_redkitchen": "depth camera, fused",
    "rgbd_single_frames": "depth camera, single frames",
}  # fmt: skip
_KINDS = (  # what dataset.json says of the sensor -> its kind; the first that is found counts
    (r"HDL-64", "HDL-64E"), (r"HDL-32", "HDL-32E"), (r"VLP-16", "VLP-16"), (r"OS0-64", "OS0-64"),
    (r"OS1-64|Ouster", "OS1-64"), (r"solid.state", "solid state"), (r"Livox", "Livox"), (r"tripod", "tripod scanner"),
    (r"fused", "depth camera, fused"), (r"depth image|RGB-?D", "depth camera, single frames"),
)  # fmt: skip


def kind_of(sensor: str, otherwise: str) -> str:
    """The kind of sensor that a data set says it was taken with; `otherwise` if it is none of the known ones."""
    return next((kind for pattern, kind in _KINDS if re.search(pattern, sensor, re.IGNORECASE)), otherwise)


def sensor_of(dataset: str) -> str:
    """The sensor of a set, or the group of simulated poses that it is."""
    return SENSORS.get(dataset, dataset)


def sensors_of(rows: Sequence[Row]) -> list[str]:
    """Every sensor once, in the order of its sets."""
    return list(dict.fromkeys(sensor_of(row.dataset) for row in rows))


def weigh_groups(rows: Sequence[Row]) -> Array:
    """Weights (N,) with which right and wrong poses of every sensor weigh the same, however many there are."""
    names = [f"{sensor_of(row.dataset)}: {row.correct}" for row in rows]
    _, group, sizes = np.unique(names, return_inverse=True, return_counts=True)
    return np.asarray(1.0 / sizes[group])
