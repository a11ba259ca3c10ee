"""Loops of a run held against each other: what confirms each other is accepted, what agrees with nothing is not.

One pair of scans cannot tell two corridors apart that are alike; a run can. Each loop has the odds of its own pair of
scans. Odometry is a witness against it where the two contradict each other by more than odometry can have drifted, and
so are stronger loops that it contradicts. Independent loops that agree with it, along the odometry between, speak for
it; loops between the same two places do not, because what fools one of them fools them all. Nor do those that were left
undecided on their pair or that fall themselves.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterable
from typing import TypeVar

import numpy as np

from svc_ros.core.config import Config
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.agreeing.consistency import PlacedLoop, ways_of
from svc_ros.pipeline.agreeing.less_drift import with_less_drift
from svc_ros.pipeline.agreeing.relations import Relations
from svc_ros.pipeline.agreeing.weighing import HeldLoop, Opinion, Weighing, log_odds_of
from svc_ros.pipeline.stream import StreamDecision, leave_undecided

ORIGIN = "agreement"
Told = TypeVar("Told", bound=StreamDecision)
_MAX_LOOPS = 500  # the newest; older ones keep the verdict they have
_UNSURE_DEG = 1.0  # of the pose of an undecided loop, which comes without a covariance


class Agreement:
    """The loops of one run, in the order in which they are told; safe from any thread, one at a time.

    Loops without odometry at both ends, and what was not accepted or left undecided with a pose, pass as they are.
    """

    def __init__(self, config: Config) -> None:
        self._config, self._lock = config, threading.Lock()
        self._loops: list[HeldLoop] = []
        self._relations = self._new_relations()
        wanted = max(config.loop_closure.min_probability, 0.5)
        self._wanted = log_odds_of(wanted)

    def reset(self) -> None:
        """Forget all loops."""
        with self._lock:
            self._loops = []
            self._relations = self._new_relations()

    def add(self, decisions: Iterable[StreamDecision], keyframes: Trajectory) -> list[StreamDecision]:
        """The decisions as they are to be told, each followed by what it changes of earlier ones.

        keyframes: odometry of all keyframes so far, along which the way between loops is measured. A change is a
        decision on the earlier pair with the origin `agreement`. An accepted loop that contradicts the rest is told as
        undecided at once, with the reason `unconfirmed`.
        """
        with self._lock:
            return [told for decision in decisions for told in self._settle(decision, keyframes)]

    def _settle(self, decision: StreamDecision, keyframes: Trajectory) -> list[StreamDecision]:
        placed = self._place(decision, keyframes)
        if placed is None:
            return [decision]
        self._keep(decision, placed)
        opinions = Weighing(self._config, self._wanted, self._loops, self._relations).opinions()
        told: list[StreamDecision] = []
        for loop, opinion in zip(self._loops[:-1], opinions, strict=False):
            if opinion.is_accepted != loop.is_accepted:
                loop.is_accepted = opinion.is_accepted
                told.append(dataclasses.replace(_revised(loop.raw, loop, opinion), origin=ORIGIN))
        return [*self._first_word(decision, self._loops[-1], opinions[-1]), *told]

    def _first_word(self, decision: StreamDecision, loop: HeldLoop, opinion: Opinion) -> list[StreamDecision]:
        """What is told of the newest loop: where others make an undecided one accepted, both are."""
        loop.is_accepted = opinion.is_accepted
        if loop.is_accepted and not loop.was_accepted:
            return [decision, dataclasses.replace(_revised(loop.raw, loop, opinion), origin=ORIGIN)]
        agrees_with_nothing = opinion.is_contradicted and opinion.num_pieces == 0
        if loop.is_accepted or not (loop.was_accepted or agrees_with_nothing):
            return [decision]
        return [_revised(decision, loop, opinion)]

    # what is known of each loop

    def _new_relations(self) -> list[Relations]:
        return [Relations(config) for config in with_less_drift(self._config)]

    def _place(self, decision: StreamDecision, keyframes: Trajectory) -> PlacedLoop | None:
        result, source, target = decision.result, decision.T_odom_source, decision.T_odom_target
        ends = decision.source_stamp_ns, decision.target_stamp_ns
        T = result.best_candidate if result.T_target_source is None else result.T_target_source
        if source is None or target is None or T is None or not set(ends) <= set(keyframes.stamps_ns.tolist()):
            return None
        if result.verdict not in (Verdict.ACCEPTED, Verdict.UNDECIDED):
            return None
        ways = ways_of(keyframes.poses)
        source_way, target_way = (ways[np.searchsorted(keyframes.stamps_ns, stamp)] for stamp in ends)
        covariance = self._unsure() if result.covariance is None else result.covariance
        return PlacedLoop(T, covariance, source, target, source_way, target_way)

    def _unsure(self) -> Array:
        shift, turn = self._config.sight_view.tolerance_m, np.radians(_UNSURE_DEG)
        return np.diag([shift**2] * 3 + [turn**2] * 3)

    def _keep(self, decision: StreamDecision, placed: PlacedLoop) -> None:
        """Hold a new loop against odometry and against all that are kept."""
        result = decision.result
        odds = self._wanted if result.probability is None else log_odds_of(result.probability)
        odds = max(odds, self._wanted) if result.accepted else odds
        light = dataclasses.replace(decision, scans=None, result=dataclasses.replace(result, evidence=None))
        others = [loop.placed for loop in self._loops]
        self._loops.append(HeldLoop(light, placed, odds))
        for relations in self._relations:
            relations.add(placed, others)
        if len(self._loops) > _MAX_LOOPS:
            self._forget_first()

    def _forget_first(self) -> None:
        for loop, gain in zip(self._loops[1:], self._relations[-1].gain[0, 1:], strict=True):
            loop.has_outlived |= bool(gain > 0.0)
        self._loops = self._loops[1:]
        for relations in self._relations:
            relations.forget_first()


def _revised(decision: StreamDecision, loop: HeldLoop, opinion: Opinion) -> StreamDecision:
    """The decision on a loop as the others have it."""
    result, why = decision.result, _why(loop, opinion)
    if not loop.is_accepted:
        if not loop.was_accepted:
            result = dataclasses.replace(result, detail=f"{result.reason.value}: {result.detail}")
        return dataclasses.replace(decision, result=leave_undecided(result, Reason.UNCONFIRMED, why))
    accepted = dataclasses.replace(
        result, verdict=Verdict.ACCEPTED, reason=Reason.OK, T_target_source=loop.placed.T_target_source,
        covariance=loop.placed.covariance, detail=f"{why}: {result.detail}",
    )  # fmt: skip
    return dataclasses.replace(decision, result=accepted)


def _why(loop: HeldLoop, opinion: Opinion) -> str:
    others = f"{opinion.num_pieces} independent loop{'s' if opinion.num_pieces != 1 else ''}"
    if loop.is_accepted and opinion.is_with_odometry:
        return "confirmed by odometry over a short way"
    if loop.is_accepted:
        return f"confirmed by {others}" if opinion.num_pieces else "no longer contradicted by surer loops"
    speaks = {"odometry": opinion.is_contradicted, "surer loops": opinion.is_outweighed}
    witnesses = [name for name, against in speaks.items() if against]
    against = f"contradicted by {' and '.join(witnesses)}" if witnesses else "no longer confirmed"
    return f"{against}, and {others if opinion.num_pieces else 'no independent loop'} agrees with it"


def pair_of(decision: StreamDecision) -> tuple[int, int]:
    """Which pair of scans a decision is on."""
    return decision.source_stamp_ns, decision.target_stamp_ns


def last_words(decisions: Iterable[Told]) -> list[Told]:
    """The decisions without those on a pair of which there is a new word."""
    last: list[Told] = []
    for decision in decisions:
        if decision.origin == ORIGIN:
            last = [earlier for earlier in last if pair_of(earlier) != pair_of(decision)]
        last.append(decision)
    return last
