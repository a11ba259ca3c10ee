"""Builds a map of one run or several: keyframes and loops of each, all poses optimised, runs joined by loops."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array, Scan
from svc_ros.io.maps.layout import MapGraph, Session
from svc_ros.io.maps.placing import MapPlace
from svc_ros.io.maps.writing import MapWriter
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.graph_optimisation import load_gtsam, optimise
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.mapping.joining import join_maps
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StampOrder, StreamDecision

Tracked = tuple[Scan, Array | None]  # a scan and its T_odom_scan (4, 4), None where odometry does not know


@dataclass(frozen=True)
class Run:
    """One way of a sensor. source: what it is called in the map; scans: in the order of their stamps; config: that
    keyframes are made and loops are judged with."""

    source: str
    scans: Iterable[Tracked]
    config: Config


def build_map(runs: Iterable[Run], out: Path, extended: Map | None = None) -> Map:
    """Write a map of all runs, or of a map extended by them, into the folder `out`, and read it.

    out: a new folder, an empty one, or that of a map, which is replaced once the new one is whole; links are followed.
    The frame of the map is the odometry frame of the first run. Raises InputError for another folder, a run without
    keyframes and one that nothing joins to those before it; MissingDependencyError without gtsam.
    """
    load_gtsam()  # before hours of work, not after them
    with MapPlace(out) as place:
        built = extended
        for number, run in enumerate(runs):
            parts = [part for part in (built, _build_run(run, _made(place.work / f"run{number}"))) if part is not None]
            built = (
                parts[0] if len(parts) == 1 else join_maps(parts[0], parts[1], _made(place.work / f"joined{number}"))
            )
            for part in parts:
                if part is not built and part is not extended:  # it would take as much room again
                    part.close()
                    shutil.rmtree(part.folder)
        if built is None or built is extended:
            raise InputError("map: expected at least one run, found none")
        built.close()
        place.put(built.folder)
    return Map.read(out)


def _build_run(run: Run, folder: Path) -> Map:
    writer = MapWriter(folder)
    try:
        poses, loops, frame_id = _write_keyframes(run, writer)
        known = set(poses.stamps_ns.tolist())
        between = [d for d in loops if {d.source_stamp_ns, d.target_stamp_ns} <= known]
        graph = build_pose_graph(poses, between, run.config.covariance)
        best = optimise(graph)
        writer.finish(MapGraph(best.poses, best.covariances, graph.edges), [Session(run.source, frame_id)], run.config)
    finally:
        writer.close()
    return Map.read(folder)


def _write_keyframes(run: Run, writer: MapWriter) -> tuple[Trajectory, list[StreamDecision], str]:
    """Write the keyframes whose odometry is known; returns their poses, the accepted loops and the clouds' frame."""
    closer, order, written = LoopCloser(run.config), StampOrder(), None
    loops: dict[tuple[int, int], StreamDecision] = {}
    frames: dict[str, None] = {}
    for scan, T_odom_scan in run.scans:
        if order.is_jump(scan.stamp_ns):
            raise InputError(f"{run.source}: expected rising stamps, found a jump back to {scan.stamp_ns} ns")
        order.lateness(scan.stamp_ns)
        for decision in closer.add(scan, T_odom_scan):
            pair = decision.source_stamp_ns, decision.target_stamp_ns
            loops.pop(pair, None)  # the last word on a pair counts
            if decision.result.accepted:
                slim = dataclasses.replace(decision.result, evidence=None)
                loops[pair] = dataclasses.replace(decision, result=slim, scans=None)
        newest = closer.newest
        if newest is not None and newest is not written and newest.T_odom_scan is not None:
            writer.add(newest.scan, newest.look.spectrum.astype(np.complex64), 0)
            written, frames[newest.scan.frame_id] = newest, None
    if len(frames) != 1:
        found = f"those of {', '.join(frames)}" if frames else "none"
        raise InputError(f"{run.source}: expected scans of one frame whose odometry is known, found {found}")
    return closer.keyframe_poses, list(loops.values()), next(iter(frames))


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder
