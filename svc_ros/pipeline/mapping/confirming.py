"""Which loops between two maps confirm each other, and which only do not contradict each other.

Far along the way drift may forgive any error. So loops confirm each other only over a way on which it forgives little,
and one that is far from all others is joined to them by those between.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.scan import Array
from svc_ros.io.g2o import PoseGraph
from svc_ros.pipeline.agreeing.consistency import PlacedLoop, fit_to_loops
from svc_ros.pipeline.agreeing.less_drift import least_that_does, with_less_drift

_LEAST_STEP_M = 1e-6  # a way of no length would be none
_NO_WAY_M = 1e6  # where no edges join two keyframes nothing is known


@dataclass(frozen=True, eq=False)
class JoiningLoop:
    """An accepted loop between a keyframe of the second map (source) and one of the first (target), by numbers.

    T_target_source (4, 4) and covariance (6, 6) as a RegistrationResult has them.
    """

    source: int
    target: int
    T_target_source: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Of each of L loops (L,), whether it contradicts one more, whether it confirms that, and whether it is of a place
    apart, so that what it says is evidence of its own."""

    contradicts: NDArray[np.bool_]
    confirms: NDArray[np.bool_]
    is_apart: NDArray[np.bool_]


class LoopJudge:
    """Holds loops between two maps against each other, along the edges of both."""

    def __init__(self, first: PoseGraph, second: PoseGraph, config: Config) -> None:
        self._first, self._second, self._config = _Ways(first), _Ways(second), config

    def surest(self, loops: Sequence[JoiningLoop]) -> tuple[LoopJudge, list[int]]:
        """One that assumes the least drift with which the loops confirm each other about as well, and their largest
        core: the less drift, the better wrong loops are told from right ones, and the farther right ones reach."""
        judges = [self._judging_by(config) for config in with_less_drift(self._config)]
        found = [(judge, judge.largest_core(loops)) for judge in judges]
        sizes = [len(core) for _, core in found]
        return least_that_does(found, sizes, max(sizes))

    def confirmation(self, this: JoiningLoop, others: Sequence[JoiningLoop]) -> Confirmation:
        """How the others, at least one, speak of a loop."""
        placed = self._placed(this, np.zeros(2), np.zeros(2))
        ways = self._second.to_all(this.source), self._first.to_all(this.target)
        along = [self._placed(loop, ways[0][loop.source], ways[1][loop.target]) for loop in others]
        fits = fit_to_loops(placed, along, self._config)
        contradicts = fits.contradicts
        # What drift makes of it is a matter of belief, so that the bare difference has to be small, too.
        unsure_m = np.maximum(fits.sigma_m, fits.shift_m)
        stands = np.array([loop.T_odom_source[:3, 3] for loop in along])
        return Confirmation(
            contradicts, ~contradicts & (unsure_m <= self._config.loop_closure.keyframe_distance_m),
            np.linalg.norm(stands - placed.T_odom_source[:3, 3], axis=1) >= self._config.agreement.independent_m,
        )  # fmt: skip

    def largest_core(self, loops: Sequence[JoiningLoop]) -> list[int]:
        """Numbers of the most loops of which no two contradict each other and that confirmations from places apart
        join to each other, in their order; none where no two loops confirm each other so."""
        if not loops:
            return []
        found = [self.confirmation(loop, loops) for loop in loops]
        agree, confirm = (
            each & each.T  # measured at either of the two
            for each in (
                ~np.array([one.contradicts for one in found]), np.array([one.confirms & one.is_apart for one in found])
            )
        )  # fmt: skip
        best: list[int] = []
        order = np.argsort(-agree.sum(axis=1), kind="stable").tolist()
        for seed in order:
            group = [seed]
            for k in order:
                if k != seed and agree[k, group].all():
                    group.append(k)
            part = connected_components(confirm[np.ix_(group, group)], directed=False)[1]
            core = [k for k, p in zip(group, part, strict=True) if p == np.bincount(part).argmax()]
            best = max(best, core, key=len)
        return sorted(best) if len(best) > 1 else []

    def _judging_by(self, config: Config) -> LoopJudge:
        judge = copy.copy(self)
        judge._config = config
        return judge

    def _placed(self, loop: JoiningLoop, source_way: Array, target_way: Array) -> PlacedLoop:
        return PlacedLoop(
            loop.T_target_source, loop.covariance, self._second.poses[loop.source], self._first.poses[loop.target],
            source_way, target_way,
        )  # fmt: skip


class _Ways:
    """How far it is between the keyframes of a map, by the shortest way along its edges."""

    def __init__(self, graph: PoseGraph) -> None:
        self.poses, self._known = graph.poses, dict[int, Array]()
        ends = np.array([(edge.source, edge.target) for edge in graph.edges], np.int64).reshape(-1, 2)
        steps = np.linalg.norm(self.poses[ends[:, 0], :3, 3] - self.poses[ends[:, 1], :3, 3], axis=1)
        # Of several edges between two keyframes one is enough: a sparse matrix would add them up.
        ends, once = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
        num = len(self.poses)
        self._steps = coo_array((np.maximum(steps[once], _LEAST_STEP_M), ends.T), shape=(num, num)).tocsr()

    def to_all(self, keyframe: int) -> Array:
        """(N, 2), how far each is [m], and how far the sensor turned on that way [rad]."""
        if keyframe not in self._known:
            length, before = dijkstra(self._steps, directed=False, indices=keyframe, return_predecessors=True)
            numbers = np.arange(len(self.poses))
            before = np.where(before < 0, numbers, before)
            turns = np.swapaxes(self.poses[before, :3, :3], 1, 2) @ self.poses[:, :3, :3]
            turned = np.where(before == numbers, 0.0, np.radians(se3.rotation_angle_deg(turns)))
            while (before != before[before]).any():  # each round adds up twice as long a way
                turned, before = turned + turned[before], before[before]
            self._known[keyframe] = np.stack([np.minimum(length, _NO_WAY_M), turned], axis=1)
        return self._known[keyframe]
