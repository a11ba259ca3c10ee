"""What a replay says about the whole way: its trajectory, and accepted links as a pose graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.agreement import ORIGIN, last_words, pair_of
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StampOrder
from svc_ros.replay.clouds import RecordedCloud, ReplayedPair, ReplayStep
from svc_ros.report.links import Link, join_scans


class Track(Protocol):
    """Collects the way of one replay.

    Where the stamps of a bag jump back, the way begins anew: what was before has no place in one trajectory.
    """

    def add(self, step: ReplayStep) -> None:
        """Take what the next cloud led to."""
        ...

    def trajectory(self) -> Trajectory:
        """Poses of the clouds' frame in one fixed frame."""
        ...

    def graph(self) -> PoseGraph:
        """The poses and what was accepted between them."""
        ...

    @property
    def num_parts(self) -> int:
        """Parts that accepted links do not join; the trajectory is that of one."""
        ...


class PairTrack:
    """Of single pairs: the largest part that accepted links join, in the frame of its first scan."""

    def __init__(self) -> None:
        self._order = StampOrder()
        self._clouds: dict[int, RecordedCloud] = {}
        self._links: list[ReplayedPair] = []

    def add(self, step: ReplayStep) -> None:
        """See Track. Of two clouds with one stamp the first counts."""
        if self._order.is_jump(step.cloud.stamp_ns):
            self._clouds, self._links = {}, []
        if not self._order.lateness(step.cloud.stamp_ns):
            self._clouds[step.cloud.index] = dataclasses.replace(step.cloud, message=None, scan=None)
        self._links += _accepted(step)

    @property
    def num_parts(self) -> int:
        """See Track."""
        return len(self._parts())

    def trajectory(self) -> Trajectory:
        """See Track; empty where nothing was accepted."""
        numbers, poses = max(self._parts(), key=lambda part: len(part[0]), default=([], np.zeros((0, 4, 4))))
        clouds = list(self._clouds.values())
        return Trajectory(np.array([clouds[k].stamp_ns for k in numbers], np.int64), poses)

    def graph(self) -> PoseGraph:
        """See Track."""
        return graph_of_links(self.trajectory(), self._links)

    def _parts(self) -> list[tuple[list[int], Array]]:
        """Numbers of clouds and their poses, of parts of two clouds and more."""
        number = {index: k for k, index in enumerate(self._clouds)}
        links = [
            Link.of(d.result, number[d.source_index], number[d.target_index])
            for d in self._links
            if d.source_index in number and d.target_index in number
        ]
        parts = join_scans(len(number), links)
        return [(part.scan_idx.tolist(), part.T_part_scan) for part in parts if len(part.scan_idx) > 1]


class StreamTrack:
    """Of scan matching: every accepted scan in the odometry frame, and the link that placed it."""

    num_parts = 1

    def __init__(self) -> None:
        self._order = StampOrder()
        self._poses: dict[int, Array] = {}
        self._links: list[ReplayedPair] = []

    def add(self, step: ReplayStep) -> None:
        """See Track."""
        if self._order.is_jump(step.cloud.stamp_ns):
            self._poses, self._links = {}, []
        if self._order.lateness(step.cloud.stamp_ns):
            return
        if step.T_odom_scan is not None:
            self._poses[step.cloud.stamp_ns] = step.T_odom_scan
        self._links += _accepted(step)

    def trajectory(self) -> Trajectory:
        """See Track."""
        poses = np.array(list(self._poses.values())).reshape(-1, 4, 4)
        return Trajectory(np.array(list(self._poses), np.int64), poses)

    def graph(self) -> PoseGraph:
        """See Track."""
        return graph_of_links(self.trajectory(), self._links)


class LoopTrack(StreamTrack):
    """Of loop closure: odometry as trajectory; keyframes, odometry between them and accepted loops as graph."""

    def __init__(self, closer: LoopCloser) -> None:
        super().__init__()
        self._closer = closer

    def add(self, step: ReplayStep) -> None:
        """See Track. The last word on a loop counts."""
        revised = {pair_of(d) for d in step.decisions if d.origin == ORIGIN}
        self._links = [d for d in self._links if pair_of(d) not in revised]
        super().add(step)

    @property
    def keyframes(self) -> Trajectory:
        """Odometry of the graph's vertices."""
        return self._closer.keyframe_poses

    def graph(self) -> PoseGraph:
        """See Track; as the node's g2o file has it."""
        keyframes = self._closer.keyframe_poses
        known = set(keyframes.stamps_ns.tolist())
        between = [d for d in self._links if {d.source_stamp_ns, d.target_stamp_ns} <= known]
        return build_pose_graph(keyframes, between, self._closer.config.covariance)


class MapTrack(StreamTrack):
    """Of localisation: accepted scans in the map's frame; in the graph also the keyframes that placed them.

    T_map_keyframe: (N, 4, 4) of all keyframes of the map.
    """

    def __init__(self, T_map_keyframe: Array) -> None:
        super().__init__()
        self._keyframes = T_map_keyframe

    def graph(self) -> PoseGraph:
        """See Track; an edge from each scan to the keyframe that placed it, the keyframes behind the scans."""
        trajectory = self.trajectory()
        number = {int(stamp): k for k, stamp in enumerate(trajectory.stamps_ns)}
        used = sorted({link.target_index for link in self._links})
        vertex = {index: len(trajectory) + k for k, index in enumerate(used)}
        edges = [
            GraphEdge(number[d.source_stamp_ns], vertex[d.target_index], d.result.T_target_source, d.result.covariance)
            for d in self._links
            if d.result.T_target_source is not None and d.result.covariance is not None
        ]
        return PoseGraph(np.concatenate([trajectory.poses, self._keyframes[used]]), edges)


def _accepted(step: ReplayStep) -> list[ReplayedPair]:
    """The accepted decisions without what is large: a long bag has many. Of two on one pair the last one counts."""
    return [
        dataclasses.replace(d, scans=None, result=dataclasses.replace(d.result, evidence=None))
        for d in last_words(step.decisions)
        if d.result.accepted
    ]


def graph_of_links(trajectory: Trajectory, links: Iterable[ReplayedPair]) -> PoseGraph:
    """A vertex for each pose, an edge for each accepted link with a covariance between two different ones of them."""
    number = {int(stamp): k for k, stamp in enumerate(trajectory.stamps_ns)}
    edges = []
    for link in links:
        T, covariance = link.result.T_target_source, link.result.covariance
        ends = number.get(link.source_stamp_ns), number.get(link.target_stamp_ns)
        if T is None or covariance is None or ends[0] is None or ends[1] is None or ends[0] == ends[1]:
            continue
        edges.append(GraphEdge(ends[0], ends[1], T, covariance))
    return PoseGraph(trajectory.poses, edges)
