"""Maps of a simulated room, written by the library's own writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mini_data import scan_room, sensor_pose

from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import PreparedScan, Scan
from svc_ros.io.g2o import GraphEdge
from svc_ros.io.maps.layout import MapGraph, Session
from svc_ros.io.maps.writing import MapWriter
from svc_ros.pipeline.place import look_at_place

S = 1_000_000_000
CONFIG = preset("lidar_indoor")
STANDS = [sensor_pose(x, y, yaw) for x, y, yaw in ((-3, 0, 0), (-1, 0.5, 30), (1, 0, 80), (3, -1, 160), (5, -2, 200))]
UP = np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 1.0]])  # free directions


def room_scans(config: Config = CONFIG) -> list[PreparedScan]:
    """One prepared scan a stand, a second apart; the second one knows free directions."""
    scans = [
        Scan(scan_room(T, seed=k), (k + 1) * S, "lidar", (0.1, 0.0, 0.0), free_directions=UP if k == 1 else None)
        for k, T in enumerate(STANDS)
    ]
    return [prepare(scan, config) for scan in scans]


def room_graph() -> MapGraph:
    """The stands, and the way between them."""
    covariances = np.array([(k + 1) * 1e-4 * np.eye(6) for k in range(len(STANDS))])
    edges = [
        GraphEdge(k, k - 1, se3.invert(STANDS[k - 1]) @ STANDS[k], 1e-4 * np.eye(6)) for k in range(1, len(STANDS))
    ]
    return MapGraph(np.array(STANDS), covariances, edges)


def write_room_map(folder: Path, config: Config = CONFIG) -> list[PreparedScan]:
    """Write a map of two runs, the last stand a run of its own; returns what was written."""
    folder.mkdir()
    writer, scans = MapWriter(folder), room_scans(config)
    for k, scan in enumerate(scans):
        writer.add(scan, look_at_place(scan).spectrum, int(k == len(scans) - 1))
    writer.finish(room_graph(), [Session("first_bag", "lidar"), Session("second_bag", "lidar")], config)
    return scans
