"""Two maps become one where loops between them agree: a run of which nothing is sure is not joined by guess.

Loops are looked for by the look of places and judged as all loops are. Each says where the second map stands in the
first. Loops from different places that confirm each other join both; from them outwards each other keyframe is judged
where that puts it, and what is confirmed in its turn is a loop, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
from svc_ros.pipeline.mapping.confirming import JoiningLoop, LoopJudge

_RIVALS = 0.5  # of as many loops as are sure, fewer may say something else


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
    """Loops between the maps that confirm each other, at least two. Raises InputError where there are none."""
    one, other = (PoseGraph(each.poses, each.graph.edges) for each in (first, second))
    by_look = list(_loops_by_look(first, second))
    judge, core = LoopJudge(one, other, second.config).surest(by_look)
    others = [loop for k, loop in enumerate(by_look) if k not in core]
    sure = [by_look[k] for k in core]
    num_rivals = sum(bool(judge.confirmation(loop, sure).contradicts.any()) for loop in others) if sure else 0
    if not sure or num_rivals >= _RIVALS * len(sure):
        raise _not_joined(first, second, by_look, len(sure))
    found, left = _grown(first, second, judge, sure, others)
    # Nothing between says which of two such groups is right, and drift alone could bring them together.
    if len(judge.largest_core(left)) >= len(sure):
        raise _not_joined(first, second, by_look, len(sure))
    return found


def _not_joined(first: Map, second: Map, by_look: Sequence[JoiningLoop], num_sure: int) -> InputError:
    return InputError(
        f"{_named(second)}: expected at least two loops with {_named(first)} from different places that agree, "
        f"and less than half as many that do not, found {len(by_look)} loops, of which {num_sure} agree: "
        "the runs are not joined"
    )


def _grown(
    first: Map, second: Map, judge: LoopJudge, sure: Sequence[JoiningLoop], others: Sequence[JoiningLoop]
) -> tuple[list[JoiningLoop], list[JoiningLoop]]:
    """The sure loops with those that they confirm one after another, outwards; and which of the others are left.

    Others are loops by look; each other keyframe of the second map is judged where the nearest loop puts it.
    """
    found, left = _absorbed(judge, sure, others)
    places = [loop.source for loop in found]
    for source in sorted(range(len(second)), key=lambda source: min(abs(source - place) for place in places)):
        if all(loop.source != source for loop in found):
            new = [loop for loop in _loops_by_place(first, second, found, source) if _is_confirmed(judge, loop, found)]
            if new:
                found, left = _absorbed(judge, [*found, *new], left)
    return found, left


def _absorbed(
    judge: LoopJudge, found: Sequence[JoiningLoop], left: Sequence[JoiningLoop]
) -> tuple[list[JoiningLoop], list[JoiningLoop]]:
    """What is found with those that are left and that it confirms, until there are no more; and the rest."""
    found, left = list(found), list(left)
    pairs = {(loop.source, loop.target) for loop in found}
    left = [loop for loop in left if (loop.source, loop.target) not in pairs]
    while new := next((loop for loop in left if _is_confirmed(judge, loop, found)), None):
        found.append(new)
        left.remove(new)
    return found, left


def _is_confirmed(judge: LoopJudge, loop: JoiningLoop, found: Sequence[JoiningLoop]) -> bool:
    speak = judge.confirmation(loop, found)
    return bool(speak.confirms.any() and not speak.contradicts.any())


def _loops_by_look(first: Map, second: Map) -> Iterator[JoiningLoop]:
    limits = second.config.loop_closure
    for source in range(len(second)):
        for target, likeness in first.similar(second.keyframe(source).look, limits.max_similar):
            if likeness >= limits.min_similarity:
                yield from _judged(first, second, (source, target), None)


def _loops_by_place(first: Map, second: Map, found: Sequence[JoiningLoop], source: int) -> Iterator[JoiningLoop]:
    """Of a keyframe of the second map with what is near where the loop nearest to it puts it."""
    limits = second.config.loop_closure
    guide = min(found, key=lambda loop: abs(loop.source - source))
    T_guide_source = se3.invert(second.poses[guide.source]) @ second.poses[source]
    T_first_source = first.poses[guide.target] @ guide.T_target_source @ T_guide_source
    for target in first.near(T_first_source, limits.max_distance_m, limits.max_near):
        guess = se3.nearest_pose(se3.invert(first.poses[target]) @ T_first_source)
        yield from _judged(first, second, (source, target), guess)


def _judged(first: Map, second: Map, pair: tuple[int, int], guess: Array | None) -> Iterator[JoiningLoop]:
    """The loop, if it is accepted."""
    with second.keyframe(pair[0]).lent() as source, first.keyframe(pair[1]).lent() as target:
        result = judge_candidate(source, target, guess, second.config)
    if result.T_target_source is not None and result.covariance is not None:
        yield JoiningLoop(*pair, result.T_target_source, result.covariance)


def _named(one: Map) -> str:
    return ", ".join(run.source for run in one.runs)
