"""Loops of a run held against each other: what confirms each other is accepted, what agrees with nothing is not.

One pair of scans cannot tell two corridors apart that are alike; a run can. Each loop has the odds of its own pair of
scans. Odometry is a witness against it where the two contradict each other by more than odometry can have drifted, and
so are stronger loops that it contradicts. Independent loops that agree with it, along the odometry between, speak for
it; loops between the same two places do not, because what fools one of them fools them all.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.consistency import PlacedLoop, distance_between, fit_to_loops, fit_to_odometry, ways_of
from svc_ros.pipeline.stream import StreamDecision, leave_undecided

ORIGIN = "agreement"
Told = TypeVar("Told", bound=StreamDecision)
_EXPECTED, _CONTRADICTS = 6.0, 22.5  # squared error of six degrees of freedom; all but one of 1000 right ones are below
_LEAST_GAIN, _MOST_GAIN = np.log(3.0), np.log(20.0)  # a corridor that repeats has about so many places to be taken for
_MOST_PIECES = 3  # more evidence than this changes nothing
_FAILURE_BETWEEN = 0.001  # how often two right loops contradict each other, because odometry between them has failed
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
    is_contradicted: bool
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
    is_outweighed: bool


class Agreement:
    """The loops of one run, in the order in which they are told; safe from any thread, one at a time.

    Loops without odometry at both ends, and what was not accepted or left undecided with a pose, pass as they are.
    """

    def __init__(self, config: Config) -> None:
        self._config, self._lock = config, threading.Lock()
        self._loops: list[_Loop] = []
        self._gain, self._contradicts, self._is_same = _square(float), _square(bool), _square(bool)
        wanted = max(config.loop_closure.min_probability, 0.5)
        self._wanted, self._failure = _log_odds(wanted), config.agreement.odometry_failure

    def reset(self) -> None:
        """Forget all loops."""
        with self._lock:
            self._loops = []
            self._gain, self._contradicts, self._is_same = _square(float), _square(bool), _square(bool)

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
        agrees_with_nothing = loop.is_contradicted and opinion.support.num_pieces == 0
        if loop.is_accepted or not (loop.was_accepted or agrees_with_nothing):
            return [decision]
        return [_revised(decision, loop, opinion)]

    def _accepts(self, loop: _Loop, opinion: _Opinion) -> bool:
        has_support = loop.was_accepted or opinion.support.has_accepted
        return has_support and opinion.log_odds >= self._wanted

    # what is known of each loop

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
        contradicted = bool(fit_to_odometry(placed, self._config).sq_error[0] > _CONTRADICTS)
        light = dataclasses.replace(decision, scans=None, result=dataclasses.replace(result, evidence=None))
        others = [loop.placed for loop in self._loops]
        self._loops.append(_Loop(light, placed, odds, contradicted, False))
        gain, contradicts, is_same = np.zeros(0), np.zeros(0, bool), np.zeros(0, bool)
        if others:
            fit = fit_to_loops(placed, others, self._config)
            spread = 2.0 * self._config.loop_closure.max_distance_m
            gain = np.minimum(np.log(spread / (np.sqrt(2.0 * np.pi) * fit.sigma_m)), _MOST_GAIN)
            gain -= 0.5 * np.maximum(fit.sq_error - _EXPECTED, 0.0)
            gain = np.where(gain >= _LEAST_GAIN, gain, 0.0)
            contradicts = fit.sq_error > _CONTRADICTS
            is_same = distance_between(placed, others) < self._config.agreement.independent_m
        self._gain = _grown(self._gain, gain)
        self._contradicts, self._is_same = _grown(self._contradicts, contradicts), _grown(self._is_same, is_same)
        if len(self._loops) > _MAX_LOOPS:
            self._loops = self._loops[1:]
            self._gain, self._contradicts = self._gain[1:, 1:], self._contradicts[1:, 1:]
            self._is_same = self._is_same[1:, 1:]

    # what the others make of it

    def _weigh(self) -> list[_Opinion]:
        """An opinion on each loop: the largest sets first, each loop against those of them that it contradicts."""
        support = [self._support(i) for i in range(len(self._loops))]
        alone = [self._odds(loop, s) for loop, s in zip(self._loops, support, strict=True)]
        weights = self._weights(alone)
        sure: list[int] = []
        opinions: dict[int, _Opinion] = {}
        for i in sorted(range(len(alone)), key=lambda i: (-weights[i], -alone[i])):
            loop, odds = self._loops[i], alone[i]
            against = [alone[j] for j in sure if self._contradicts[i, j]]
            if against:
                # What fools one loop may fool its neighbours: against surer ones they all are one piece of evidence.
                doubt = np.log(_FAILURE_BETWEEN + (1.0 - _FAILURE_BETWEEN) * _probability(-max(against)))
                odds = min(odds, loop.log_odds + min(support[i].plain, _MOST_GAIN) + float(doubt))
            opinions[i] = _Opinion(odds, support[i], bool(against))
            if self._accepts(loop, opinions[i]):
                sure.append(i)
        return [opinions[i] for i in range(len(alone))]

    def _weights(self, alone: Sequence[float]) -> NDArray[np.float64]:
        """(L,), of each loop the weight of a set that it belongs to, in which no two contradict each other and each
        agrees with another one; loops between the same places weigh once."""
        weights = np.zeros(len(alone))
        chances = np.array([_probability(loop.log_odds) for loop in self._loops])
        for seed in sorted(range(len(alone)), key=lambda i: -alone[i]):
            if weights[seed] > 0.0:
                continue
            members, is_free = [seed], ~self._contradicts[seed]
            is_free[seed] = False
            gain = np.where(is_free, self._gain[seed], 0.0)
            while gain.max() > 0.0:
                best = int(np.argmax(gain * chances))
                members.append(best)
                is_free &= ~self._contradicts[best]
                is_free[best] = False
                gain = np.where(is_free, np.maximum(gain, self._gain[best]), 0.0)
            counted: list[int] = []
            for j in sorted(members, key=lambda j: -chances[j]):
                if not self._is_same[j, counted].any():
                    counted.append(j)
            weights[members] = np.maximum(weights[members], chances[counted].sum())
        return weights

    def _support(self, i: int) -> _Support:
        """What independent loops say for one."""
        partners = np.flatnonzero((self._gain[i] > 0.0) & ~self._is_same[i])
        chances = {j: _probability(self._loops[j].log_odds) for j in partners.tolist()}
        worth = {j: float(np.log(p * np.exp(self._gain[i, j]) + 1.0 - p)) for j, p in chances.items()}
        pieces: list[int] = []
        for j in sorted(worth, key=lambda j: -worth[j]):
            if len(pieces) < _MOST_PIECES and not self._is_same[j, pieces].any():
                pieces.append(j)
        plain = sum(worth[j] for j in pieces)
        shared = plain - sum(float(np.log(1.0 - chances[j] + chances[j] * self._failure)) for j in pieces)
        return _Support(plain, shared, len(pieces), any(self._loops[j].was_accepted for j in pieces))

    def _odds(self, loop: _Loop, support: _Support) -> float:
        """With the word of odometry, which where it failed did so for all loops at once."""
        if loop.is_contradicted:
            return loop.log_odds + float(np.log(self._failure)) + support.shared
        return loop.log_odds + support.plain


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
    speaks = {"odometry": loop.is_contradicted, "surer loops": opinion.is_outweighed}
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


def _square(kind: type) -> NDArray[np.generic]:
    return np.zeros((0, 0), kind)


def _grown(square: NDArray[np.generic], row: NDArray[np.generic]) -> NDArray[np.generic]:
    """With one more row and column; nothing on the diagonal."""
    grown = np.zeros((len(square) + 1, len(square) + 1), square.dtype)
    grown[:-1, :-1], grown[-1, :-1], grown[:-1, -1] = square, row, row
    return grown


def _log_odds(probability: float) -> float:
    p = min(max(probability, _LEAST_PROBABILITY), _MOST_PROBABILITY)
    return float(np.log(p / (1.0 - p)))


def _probability(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-log_odds)))
