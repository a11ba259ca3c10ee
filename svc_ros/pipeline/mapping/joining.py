"""Two maps become one where loops between them agree: a run of which nothing is sure is not joined by guess.

Loops are looked for by the look of places and judged as all loops are. Each says where the second map stands in the
first. Loops from different places of the second map that say the same join both; then each other keyframe is judged
where that puts it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array
from svc_ros.io.g2o import GraphEdge, PoseGraph
from svc_ros.io.maps.layout import MapGraph
from svc_ros.io.maps.writing import MapWriter
from svc_ros.pipeline.consistency import PlacedLoop, fit_to_loops, ways_of
from svc_ros.pipeline.graph_optimisation import optimise
from svc_ros.pipeline.loop_closure import judge_candidate
from svc_ros.pipeline.map import Map

_MOST_SQ_ERROR = 22.5  # of six degrees of freedom: what agrees is below, but for one in a thousand
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
    placed = [place_loop(loop, first, second) for loop in by_look]
    group = largest_agreement(placed, second.config)
    num_rivals = len(by_look) - len(group)
    if not _confirm_each_other([placed[k] for k in group], second.config) or num_rivals >= _RIVALS * len(group):
        raise InputError(
            f"{_named(second)}: expected at least two loops with {_named(first)} from different places that agree, "
            f"and less than half as many that do not, found {len(by_look)} loops, of which {len(group)} agree: "
            "the runs are not joined"
        )
    agreeing = [by_look[k] for k in group]
    known = {loop.source for loop in agreeing}
    others = [k for k in range(len(second)) if k not in known]
    return agreeing + list(_loops_by_place(first, second, agreeing, others))


def place_loop(loop: JoiningLoop, first: Map, second: Map) -> PlacedLoop:
    """The loop on both ways: its target's way is that of the first map, its source's that of the second."""
    source_way, target_way = ways_of(second.poses)[loop.source], ways_of(first.poses)[loop.target]
    return PlacedLoop(
        loop.T_target_source, loop.covariance, second.poses[loop.source], first.poses[loop.target], source_way,
        target_way,
    )  # fmt: skip


def largest_agreement(loops: Sequence[PlacedLoop], config: Config) -> list[int]:
    """Numbers of the most loops of which no two contradict each other, in their order; found from each in turn."""
    agree = np.array([fit_to_loops(loop, loops, config).sq_error <= _MOST_SQ_ERROR for loop in loops])
    best: list[int] = []
    order = np.argsort(-agree.sum(axis=1), kind="stable").tolist() if len(loops) else []
    for seed in order:
        group = [seed]
        for k in order:
            if k != seed and agree[k, group].all() and agree[group, k].all():
                group.append(k)
        best = max(best, group, key=len)
    return sorted(best)


def _confirm_each_other(loops: Sequence[PlacedLoop], config: Config) -> bool:
    """True where two of them come from different places, and drift alone could not bring them together."""
    apart_m, sure_m = config.agreement.independent_m, config.loop_closure.keyframe_distance_m
    return any(
        bool(((np.linalg.norm(_sources(loops) - loop.T_odom_source[:3, 3], axis=1) >= apart_m)
              & (fit_to_loops(loop, loops, config).sigma_m <= sure_m)).any())
        for loop in loops
    )  # fmt: skip


def _sources(loops: Sequence[PlacedLoop]) -> Array:
    """(L, 3) [m], where their sources stand."""
    return np.array([loop.T_odom_source[:3, 3] for loop in loops])


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
                fit = fit_to_loops(place_loop(loop, first, second), [place_loop(guide, first, second)], second.config)
                if fit.sq_error[0] <= _MOST_SQ_ERROR:
                    yield loop


def _judged(first: Map, second: Map, pair: tuple[int, int], guess: Array | None) -> Iterator[JoiningLoop]:
    """The loop, if it is accepted."""
    with second.keyframe(pair[0]).lent() as source, first.keyframe(pair[1]).lent() as target:
        result = judge_candidate(source, target, guess, second.config)
    if result.T_target_source is not None and result.covariance is not None:
        yield JoiningLoop(*pair, result.T_target_source, result.covariance)


def _named(one: Map) -> str:
    return ", ".join(run.source for run in one.runs)
