"""Loops of a run held against each other: what confirms each other is accepted, what agrees with nothing is not.

One pair of scans cannot tell two corridors apart that are alike; a run can. Each loop has the odds of its own pair of
scans. Odometry is a witness against it where the two contradict each other by more than odometry can have drifted, and
so are stronger loops that it contradicts. Independent loops that agree with it, along the odometry between, speak for
it; loops between the same two places do not, because what fools one of them fools them all.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config, values_of, with_values
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.consistency import PlacedLoop, ways_of
from svc_ros.pipeline.relations import MOST_GAIN, Relations
from svc_ros.pipeline.stream import StreamDecision, leave_undecided

ORIGIN = "agreement"
Told = TypeVar("Told", bound=StreamDecision)
_MOST_PIECES = 3  # more evidence than this changes nothing
_FAILURE_BETWEEN = 0.001  # how often two right loops contradict each other, because odometry between them has failed
_SHARES = (0.1, 0.3, 1.0)  # of the drift that is possible: most odometry is better, and tells wrong loops better then
_AS_WELL, _MANY = 0.7, 4.0  # of the weight of the loops that agree; with fewer than so many nobody knows
_LEAST_PROBABILITY, _MOST_PROBABILITY = 1e-3, 0.99
_MAX_LOOPS = 500  # the newest; older ones keep the verdict they have
_UNSURE_DEG = 1.0  # of the pose of an undecided loop, which comes without a covariance


@dataclasses.dataclass(eq=False)
class _Loop:
    """raw: the decision on the pair alone; placed: where its ends stand; log_odds: of the pair alone; is_accepted: the
    last word on it."""

    raw: StreamDecision
    placed: PlacedLoop
    log_odds: float
    is_accepted: bool

    @property
    def was_accepted(self) -> bool:
        return self.raw.result.accepted


@dataclasses.dataclass(frozen=True)
class _Support:
    """plain: log odds that loops add which agree; shared: the same where odometry must have failed for all of them;
    num_pieces: how many of them are independent; has_accepted: one of them was accepted on its pair alone."""

    plain: float
    shared: float
    num_pieces: int
    has_accepted: bool


@dataclasses.dataclass(frozen=True)
class _Opinion:
    log_odds: float
    support: _Support
    is_contradicted: bool
    is_outweighed: bool


class Agreement:
    """The loops of one run, in the order in which they are told; safe from any thread, one at a time.

    Loops without odometry at both ends, and what was not accepted or left undecided with a pose, pass as they are.
    """

    def __init__(self, config: Config) -> None:
        self._config, self._lock = config, threading.Lock()
        self._loops: list[_Loop] = []
        self._relations = self._new_relations()
        wanted = max(config.loop_closure.min_probability, 0.5)
        self._wanted, self._failure = _log_odds(wanted), config.agreement.odometry_failure

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
        opinions = self._weigh()
        told: list[StreamDecision] = []
        for loop, opinion in zip(self._loops[:-1], opinions, strict=False):
            is_accepted = self._accepts(loop, opinion)
            if is_accepted != loop.is_accepted:
                loop.is_accepted = is_accepted
                told.append(dataclasses.replace(_revised(loop.raw, loop, opinion), origin=ORIGIN))
        return [*self._first_word(decision, self._loops[-1], opinions[-1]), *told]

    def _first_word(self, decision: StreamDecision, loop: _Loop, opinion: _Opinion) -> list[StreamDecision]:
        """What is told of the newest loop: where others make an undecided one accepted, both are."""
        loop.is_accepted = self._accepts(loop, opinion)
        if loop.is_accepted and not loop.was_accepted:
            return [decision, dataclasses.replace(_revised(loop.raw, loop, opinion), origin=ORIGIN)]
        agrees_with_nothing = opinion.is_contradicted and opinion.support.num_pieces == 0
        if loop.is_accepted or not (loop.was_accepted or agrees_with_nothing):
            return [decision]
        return [_revised(decision, loop, opinion)]

    def _accepts(self, loop: _Loop, opinion: _Opinion) -> bool:
        has_support = loop.was_accepted or opinion.support.has_accepted
        return has_support and opinion.log_odds >= self._wanted

    # what is known of each loop

    def _new_relations(self) -> list[Relations]:
        names = ("agreement.drift_ratio", "agreement.drift_deg_per_metre")
        values = values_of(self._config)
        return [
            Relations(with_values(self._config, {n: max(share * float(values[n]), 1e-4) for n in names}))
            for share in _SHARES
        ]

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
        odds = self._wanted if result.probability is None else _log_odds(result.probability)
        odds = max(odds, self._wanted) if result.accepted else odds
        light = dataclasses.replace(decision, scans=None, result=dataclasses.replace(result, evidence=None))
        others = [loop.placed for loop in self._loops]
        self._loops.append(_Loop(light, placed, odds, False))
        for relations in self._relations:
            relations.add(placed, others)
        if len(self._loops) > _MAX_LOOPS:
            self._loops = self._loops[1:]
            for relations in self._relations:
                relations.forget_first()

    # what the others make of it

    def _weigh(self) -> list[_Opinion]:
        """An opinion on each loop: the largest sets first, each loop against those of them that it contradicts."""
        relations, support, alone, weights = self._assume()
        sure: list[int] = []
        opinions: dict[int, _Opinion] = {}
        for i in sorted(range(len(alone)), key=lambda i: (-weights[i], -alone[i])):
            loop, odds = self._loops[i], alone[i]
            against = [alone[j] for j in sure if relations.contradicts[i, j]]
            if against:
                # What fools one loop may fool its neighbours: against surer ones they all are one piece of evidence.
                doubt = np.log(_FAILURE_BETWEEN + (1.0 - _FAILURE_BETWEEN) * _probability(-max(against)))
                odds = min(odds, loop.log_odds + min(support[i].plain, MOST_GAIN) + float(doubt))
            opinions[i] = _Opinion(odds, support[i], relations.by_odometry[i], bool(against))
            if self._accepts(loop, opinions[i]):
                sure.append(i)
        return [opinions[i] for i in range(len(alone))]

    def _assume(self) -> tuple[Relations, list[_Support], list[float], NDArray[np.float64]]:
        """With how little drift the loops still agree about as well as with all that is possible: relations, support,
        log odds by support alone, and weights."""
        chances = np.array([_probability(loop.log_odds) for loop in self._loops])
        found = []
        for relations in self._relations:
            support = [self._support(i, relations) for i in range(len(self._loops))]
            alone = [self._odds(i, relations, s) for i, s in enumerate(support)]
            found.append((relations, support, alone, relations.weights(alone, chances)))
        most = found[-1][-1].max()
        enough = _AS_WELL * most if most >= _MANY else np.inf
        return next((each for each in found if each[-1].max() >= enough), found[-1])

    def _support(self, i: int, relations: Relations) -> _Support:
        """What independent loops say for one."""
        gain = relations.gain[i]
        partners = np.flatnonzero((gain > 0.0) & ~relations.is_same[i])
        chances = {j: _probability(self._loops[j].log_odds) for j in partners.tolist()}
        worth = {j: float(np.log(p * np.exp(gain[j]) + 1.0 - p)) for j, p in chances.items()}
        pieces = relations.pieces(sorted(worth, key=lambda j: -worth[j]), _MOST_PIECES)
        plain = sum(worth[j] for j in pieces)
        shared = plain - sum(float(np.log(1.0 - chances[j] + chances[j] * self._failure)) for j in pieces)
        return _Support(plain, shared, len(pieces), any(self._loops[j].was_accepted for j in pieces))

    def _odds(self, i: int, relations: Relations, support: _Support) -> float:
        """With the word of odometry, which where it failed did so for all loops at once."""
        if relations.by_odometry[i]:
            return self._loops[i].log_odds + float(np.log(self._failure)) + support.shared
        return self._loops[i].log_odds + support.plain


def _revised(decision: StreamDecision, loop: _Loop, opinion: _Opinion) -> StreamDecision:
    """The decision on a loop as the others have it."""
    result, why = decision.result, _why(loop, opinion)
    if not loop.is_accepted:
        return dataclasses.replace(decision, result=leave_undecided(result, Reason.UNCONFIRMED, why))
    accepted = dataclasses.replace(
        result, verdict=Verdict.ACCEPTED, reason=Reason.OK, T_target_source=loop.placed.T_target_source,
        covariance=loop.placed.covariance, detail=f"{why}: {result.detail}",
    )  # fmt: skip
    return dataclasses.replace(decision, result=accepted)


def _why(loop: _Loop, opinion: _Opinion) -> str:
    others = f"{opinion.support.num_pieces} independent loop{'s' if opinion.support.num_pieces != 1 else ''}"
    if loop.is_accepted:
        return f"confirmed by {others}" if opinion.support.num_pieces else "no longer contradicted by surer loops"
    speaks = {"odometry": opinion.is_contradicted, "surer loops": opinion.is_outweighed}
    witnesses = [name for name, against in speaks.items() if against]
    against = f"contradicted by {' and '.join(witnesses)}" if witnesses else "no longer confirmed"
    return f"{against}, and {others if opinion.support.num_pieces else 'no independent loop'} agrees with it"


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


def _log_odds(probability: float) -> float:
    p = min(max(probability, _LEAST_PROBABILITY), _MOST_PROBABILITY)
    return float(np.log(p / (1.0 - p)))


def _probability(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-log_odds)))
