"""The way that decisions tell: parts, jumps back in time, and graphs of what was accepted."""

from __future__ import annotations

import numpy as np
import pytest

from svc_ros.core import se3
from svc_ros.core.config import preset
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Scan
from svc_ros.pipeline.loop_closure import LoopCloser
from svc_ros.replay.clouds import RecordedCloud, ReplayedPair, ReplayStep
from svc_ros.replay.track import LoopTrack, PairTrack, StreamTrack

SECOND = 1_000_000_000
COVARIANCE = np.diag([0.01] * 6)


def pose(x: float) -> np.ndarray:
    return se3.make_pose(np.eye(3), (x, 0.0, 0.0))


def link(source: int, target: int, x: float | None, stamps: list[int], covariance: bool = True) -> ReplayedPair:
    """Accepted at x metres, or rejected."""
    if x is None:
        result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, best_candidate=pose(9.0))
    else:
        matrix = COVARIANCE if covariance else None
        result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, T_target_source=pose(x), covariance=matrix)
    return ReplayedPair(
        result, stamps[source], stamps[target], "lidar", "lidar", source_index=source, target_index=target
    )


def step(index: int, stamps: list[int], decisions: list[ReplayedPair], T: np.ndarray | None = None) -> ReplayStep:
    return ReplayStep(RecordedCloud(index, stamps[index], "lidar", stamps[index], None), decisions, T)


def pair_track(stamps: list[int], distances: list[float | None]) -> PairTrack:
    track = PairTrack()
    for k in range(len(stamps)):
        track.add(step(k, stamps, [link(k, k - 1, distances[k - 1], stamps)] if k else []))
    return track


def test_the_largest_part_of_the_pairs_is_the_trajectory() -> None:
    stamps = [k * SECOND for k in range(7)]
    track = pair_track(stamps, [1.0, None, 2.0, 2.0, 2.0, None])
    found = track.trajectory()
    assert track.num_parts == 2  # a scan alone is none
    assert found.stamps_ns.tolist() == stamps[2:6]
    np.testing.assert_allclose(found.poses[:, 0, 3], [0.0, 2.0, 4.0, 6.0])
    graph = track.graph()
    assert [(e.source, e.target) for e in graph.edges] == [(1, 0), (2, 1), (3, 2)]


def test_nothing_accepted_is_no_trajectory() -> None:
    track = pair_track([0, SECOND, 2 * SECOND], [None, None])
    assert (len(track.trajectory()), track.num_parts, len(track.graph().poses)) == (0, 0, 0)


@pytest.mark.parametrize("kind", [PairTrack, StreamTrack])
def test_a_jump_back_in_time_begins_anew(kind: type) -> None:
    stamps = [10 * SECOND, 11 * SECOND, 2 * SECOND, 3 * SECOND, 4 * SECOND]
    track = kind()
    for k in range(5):
        track.add(step(k, stamps, [link(k, k - 1, 1.0, stamps)] if k else [], pose(k)))
    assert track.trajectory().stamps_ns.tolist() == stamps[2:]
    assert [(e.source, e.target) for e in track.graph().edges] == [(1, 0), (2, 1)]


@pytest.mark.parametrize("kind", [PairTrack, StreamTrack])
def test_a_late_scan_has_no_place_in_the_trajectory(kind: type) -> None:
    stamps = [10 * SECOND, 12 * SECOND, 12 * SECOND - 5, 13 * SECOND]
    track = kind()
    for k in range(4):
        track.add(step(k, stamps, [link(k, 0, float(k), stamps)] if k else [], pose(k)))
    assert track.trajectory().stamps_ns.tolist() == [stamps[0], stamps[1], stamps[3]]


def test_links_without_covariance_are_no_edges() -> None:
    stamps = [0, SECOND]
    track = StreamTrack()
    track.add(step(0, stamps, [link(0, 0, 0.0, stamps)], pose(0.0)))  # the first scan, linked with itself
    track.add(step(1, stamps, [link(1, 0, 1.0, stamps, covariance=False)], pose(1.0)))
    assert (len(track.graph().poses), len(track.graph().edges)) == (2, 0)


def test_loops_of_keyframes_without_odometry_are_no_edges() -> None:
    """As in the node's file: what has no place has no vertex."""
    closer, points = LoopCloser(preset("lidar_indoor")), np.random.default_rng(0).uniform(-9, 9, (3000, 3))
    track, stamps = LoopTrack(closer), [k * SECOND for k in range(3)]
    for k, T in enumerate([pose(0.0), None, pose(6.0)]):
        closer.add(Scan(points, stamps[k], "lidar"), T)
        track.add(step(k, stamps, [link(2, 1, 1.0, stamps), link(2, 0, 6.0, stamps)] if k == 2 else [], T))
    assert [(e.source, e.target) for e in track.graph().edges] == [(1, 0), (1, 0)]  # odometry, and one of the loops


def test_loops_are_edges_between_keyframes() -> None:
    config = preset("lidar_indoor")
    closer, points = LoopCloser(config), np.random.default_rng(0).uniform(-9, 9, (3000, 3))
    track, stamps = LoopTrack(closer), [k * SECOND for k in range(4)]
    for k in range(4):
        T = pose(3.0 * k)
        closer.add(Scan(points, stamps[k], "lidar"), T)
        loops = [link(3, 0, 9.0, stamps), link(3, 1, None, stamps)] if k == 3 else []
        track.add(step(k, stamps, loops, T))
    graph = track.graph()
    assert [(e.source, e.target) for e in graph.edges] == [(1, 0), (2, 1), (3, 2), (3, 0)]
    np.testing.assert_allclose(track.trajectory().poses[:, 0, 3], [0.0, 3.0, 6.0, 9.0])
