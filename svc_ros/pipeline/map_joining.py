"""Two maps become one where loops between them agree: a run of which nothing is sure is not joined by guess.

Loops are looked for by the look of places and judged as all loops are. Each says where the second map stands in the
first. Loops from different places of the second map that say the same join both; then each other keyframe is judged
where that puts it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.maps.layout import MapGraph
from svc_ros.io.maps.writing import MapWriter
from svc_ros.pipeline.graph_optimisation import optimise
from svc_ros.pipeline.loop_closure import judge_candidate
from svc_ros.pipeline.map import Map
from svc_ros.pipeline.pose_graph import DRIFT

_LEAST = 2  # loops that have to agree
_SIGMAS = 3.0
_RIVALS = 0.5  # of as many loops as agree, fewer may say something else


@dataclass(frozen=True, eq=False)
class JoiningLoop:
    """An accepted loop between a keyframe of the second map (source) and one of the first (target), by numbers.

    T_target_source (4, 4) and covariance (6, 6) as a RegistrationResult has them.
    """

    source: int
    target: int
    T_target_source: Array
    covariance: Array


def join_maps(first: Map, second: Map, folder: Path) -> Map:
    """Write both as one map into an existing folder, in the frame of the first, all poses optimised together.

    Raises InputError where the keyframes of the two are of different kinds, and where nothing joins them for sure.
    """
    first.check_fits(second.config)
    loops = find_joining_loops(first, second)
    T_first_second = first.poses[loops[0].target] @ loops[0].T_target_source @ se3.invert(second.poses[loops[0].source])
    num = len(first)
    between = [GraphEdge(num + loop.source, loop.target, loop.T_target_source, loop.covariance) for loop in loops]
    moved = [
        GraphEdge(num + edge.source, num + edge.target, edge.T_target_source, edge.covariance)
        for edge in second.graph.edges
    ]
    edges = [*first.graph.edges, *moved, *between]
    best = optimise(PoseGraph(np.concatenate([first.poses, T_first_second @ second.poses]), edges))
    writer = MapWriter(folder)
    try:
        first.copy_into(writer, 0)
        second.copy_into(writer, len(first.runs))
        graph = MapGraph(best.poses, best.covariances, edges)
        writer.finish(graph, [*first.runs, *second.runs], first.config)
    finally:
        writer.close()
    return Map.read(folder)


def find_joining_loops(first: Map, second: Map) -> list[JoiningLoop]:
    """Loops between the maps that agree with each other, at least two. Raises InputError where there are none."""
    by_look = list(_loops_by_look(first, second))
    agreeing = largest_agreement(by_look, first.poses, second.poses)
    num_rivals = len(by_look) - len(agreeing)
    apart = _sources_apart(agreeing, second)
    if len(agreeing) < _LEAST or apart < second.config.loop_closure.keyframe_distance_m or (
        num_rivals >= _RIVALS * len(agreeing)
    ):  # fmt: skip
        raise InputError(
            f"{_named(second)}: expected at least {_LEAST} loops with {_named(first)} from different places that "
            f"agree, and less than half as many that do not, found {len(by_look)} loops, of which {len(agreeing)} "
            f"agree, from places up to {apart:.1f} m apart: the runs are not joined"
        )
    known = {loop.source for loop in agreeing}
    others = [k for k in range(len(second)) if k not in known]
    return agreeing + list(_loops_by_place(first, second, agreeing, others))


def largest_agreement(
    loops: Sequence[JoiningLoop], first_poses: Array, second_poses: Array
) -> list[JoiningLoop]:
    """The most loops that agree with one of them, and with each other; by the number of their sources.

    first_poses (N, 4, 4), second_poses (M, 4, 4): of the keyframes of both maps, each in its own frame.
    """
    agrees = np.array(
        [[_agree(one, other, first_poses, second_poses) for other in loops] for one in loops], bool
    ).reshape(len(loops), len(loops))
    best: list[int] = []
    for seed in np.argsort(-agrees.sum(1), kind="stable").tolist():
        if agrees[seed].sum() <= len(best):
            break
        found = [seed]
        for k in np.argsort(-agrees.sum(1), kind="stable").tolist():
            if k != seed and agrees[k, found].all():
                found.append(k)
        best = max(best, found, key=len)
    return [loops[k] for k in sorted(best)]


def _agree(one: JoiningLoop, other: JoiningLoop, first_poses: Array, second_poses: Array) -> bool:
    """True if both put the second map at the same place, as far as they and the ways between them tell."""
    T_one_other = se3.invert(second_poses[one.source]) @ second_poses[other.source]
    said_by_one = first_poses[one.target] @ one.T_target_source @ T_one_other
    said_by_other = first_poses[other.target] @ other.T_target_source
    turn_deg, shift = se3.pose_error(said_by_one, said_by_other)
    begin, end = sorted((one.source, other.source))
    steps = np.diff(second_poses[begin : end + 1, :3, 3], axis=0)
    way = float(np.linalg.norm(steps, axis=1).sum())
    way += float(np.linalg.norm(first_poses[one.target, :3, 3] - first_poses[other.target, :3, 3]))
    turns = [_sigma(loop, slice(3, 6)) for loop in (one, other)]
    shifts = [_sigma(loop, slice(0, 3)) for loop in (one, other)]
    lever = float(np.linalg.norm(T_one_other[:3, 3]))
    turn_limit = _SIGMAS * sum(turns) + DRIFT * np.radians(_turned_deg(second_poses[begin : end + 1]))
    return bool(
        np.radians(turn_deg) <= turn_limit and shift <= _SIGMAS * (sum(shifts) + turns[0] * lever) + DRIFT * way
    )


def _turned_deg(poses: Array) -> float:
    """How far a way turned, all steps together."""
    return sum(se3.pose_error(a, b)[0] for a, b in pairwise(poses))


def _sigma(loop: JoiningLoop, part: slice) -> float:
    """Of the worst direction, in m or rad."""
    return float(np.sqrt(np.linalg.eigvalsh(loop.covariance[part, part])[-1]))


def _sources_apart(loops: Sequence[JoiningLoop], second: Map) -> float:
    places = second.poses[[loop.source for loop in loops], :3, 3]
    return max((float(np.linalg.norm(places - place, axis=1).max()) for place in places), default=0.0)


def _loops_by_look(first: Map, second: Map) -> Iterator[JoiningLoop]:
    limits = second.config.loop_closure
    for source in range(len(second)):
        for target, likeness in first.similar(second.keyframe(source).look, limits.max_similar):
            if likeness >= limits.min_similarity:
                yield from _judged(first, second, (source, target), None)


def _loops_by_place(
    first: Map, second: Map, agreeing: Sequence[JoiningLoop], others: Sequence[int]
) -> Iterator[JoiningLoop]:
    """Of the other keyframes of the second map with what is near, each where the loop nearest to it says."""
    limits = second.config.loop_closure
    for source in others:
        guide = min(agreeing, key=lambda loop: abs(loop.source - source))
        T_guide_source = se3.invert(second.poses[guide.source]) @ second.poses[source]
        T_first_source = first.poses[guide.target] @ guide.T_target_source @ T_guide_source
        for target in first.near(T_first_source, limits.max_distance_m, limits.max_near):
            guess = se3.nearest_pose(se3.invert(first.poses[target]) @ T_first_source)
            for loop in _judged(first, second, (source, target), guess):
                if _agree(guide, loop, first.poses, second.poses):
                    yield loop


def _judged(first: Map, second: Map, pair: tuple[int, int], guess: Array | None) -> Iterator[JoiningLoop]:
    """The loop, if it is accepted."""
    with second.keyframe(pair[0]).lent() as source, first.keyframe(pair[1]).lent() as target:
        result = judge_candidate(source, target, guess, second.config)
    if result.T_target_source is not None and result.covariance is not None:
        yield JoiningLoop(*pair, result.T_target_source, result.covariance)


def _named(one: Map) -> str:
    return ", ".join(run.source for run in one.runs)
