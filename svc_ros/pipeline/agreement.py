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

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Array
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.consistency import PlacedLoop, fit_to_loops, fit_to_odometry
from svc_ros.pipeline.stream import StreamDecision, leave_undecided

ORIGIN = "agreement"
_AGREES, _CONTRADICTS = 16.8, 22.5  # squared error of six degrees of freedom: 99 and 99.9 of 100 right ones are below
_LEAST_GAIN, _MOST_GAIN = np.log(3.0), np.log(20.0)  # a corridor that repeats has about so many places to be taken for
_MOST_PIECES = 3  # more evidence than this changes nothing
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
class _Opinion:
    log_odds: float
    num_agreeing: int
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
                told.append(dataclasses.replace(self._revised(loop, opinion), origin=ORIGIN))
        return [*self._first_word(self._loops[-1], opinions[-1]), *told]

    def _first_word(self, loop: _Loop, opinion: _Opinion) -> list[StreamDecision]:
        """What is told of the newest loop: where others make an undecided one accepted, both are."""
        loop.is_accepted = self._accepts(loop, opinion)
        if loop.is_accepted and not loop.was_accepted:
            return [loop.raw, dataclasses.replace(self._revised(loop, opinion), origin=ORIGIN)]
        agrees_with_nothing = loop.is_contradicted and opinion.num_agreeing == 0
        if loop.is_accepted or not (loop.was_accepted or agrees_with_nothing):
            return [loop.raw]
        return [self._revised(loop, opinion)]

    def _accepts(self, loop: _Loop, opinion: _Opinion) -> bool:
        has_support = loop.was_accepted or opinion.num_agreeing > 0
        return has_support and opinion.log_odds >= self._wanted

    def _revised(self, loop: _Loop, opinion: _Opinion) -> StreamDecision:
        """The decision on a loop as the others have it."""
        result, why = loop.raw.result, _why(loop, opinion)
        if not loop.is_accepted:
            return dataclasses.replace(loop.raw, result=leave_undecided(result, Reason.UNCONFIRMED, why))
        accepted = dataclasses.replace(
            result, verdict=Verdict.ACCEPTED, reason=Reason.OK, T_target_source=loop.placed.T_target_source,
            covariance=loop.placed.covariance, detail=f"{why}: {result.detail}",
        )  # fmt: skip
        return dataclasses.replace(loop.raw, result=accepted)

    # what is known of each loop

    def _place(self, decision: StreamDecision, keyframes: Trajectory) -> PlacedLoop | None:
        result, source, target = decision.result, decision.T_odom_source, decision.T_odom_target
        ends = decision.source_stamp_ns, decision.target_stamp_ns
        T = result.best_candidate if result.T_target_source is None else result.T_target_source
        if source is None or target is None or T is None or not set(ends) <= set(keyframes.stamps_ns.tolist()):
            return None
        if result.verdict not in (Verdict.ACCEPTED, Verdict.UNDECIDED):
            return None
        ways = _ways(keyframes.poses)
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
            gain = np.log(spread / (np.sqrt(2.0 * np.pi) * fit.sigma_m)) - 0.5 * (fit.offset_m / fit.sigma_m) ** 2
            gain = np.where((fit.sq_error <= _AGREES) & (gain >= _LEAST_GAIN), np.minimum(gain, _MOST_GAIN), 0.0)
            contradicts = fit.sq_error > _CONTRADICTS
            is_same = _apart(placed, others) < self._config.agreement.independent_m
        self._gain = _grown(self._gain, gain)
        self._contradicts, self._is_same = _grown(self._contradicts, contradicts), _grown(self._is_same, is_same)
        if len(self._loops) > _MAX_LOOPS:
            self._loops = self._loops[1:]
            self._gain, self._contradicts = self._gain[1:, 1:], self._contradicts[1:, 1:]
            self._is_same = self._is_same[1:, 1:]

    # what the others make of it

    def _weigh(self) -> list[_Opinion]:
        """An opinion on each loop: the surest first, each of the others against those of them that it contradicts."""
        support = [self._support(i) for i in range(len(self._loops))]
        alone = [self._odds(loop, *s) for loop, s in zip(self._loops, support, strict=True)]
        sure: list[int] = []
        opinions: dict[int, _Opinion] = {}
        for i in sorted(range(len(alone)), key=lambda i: -alone[i]):
            loop, (plain, _, num) = self._loops[i], support[i]
            against = [alone[j] for j in sure if self._contradicts[i, j]]
            odds = alone[i]
            if against:
                doubt = np.log(self._failure + (1.0 - self._failure) * _probability(-max(against)))
                odds = min(odds, loop.log_odds + plain + min(float(doubt), self._penalty(loop)))
            opinions[i] = _Opinion(odds, num, bool(against) and odds < self._wanted <= alone[i])
            if self._accepts(loop, opinions[i]):
                sure.append(i)
        return [opinions[i] for i in range(len(alone))]

    def _support(self, i: int) -> tuple[float, float, int]:
        """Log odds that independent loops add, the same where odometry must have failed for all of them at once, and
        how many pieces of evidence there are."""
        partners = np.flatnonzero((self._gain[i] > 0.0) & ~self._is_same[i])
        chances = {j: _probability(self._loops[j].log_odds) for j in partners.tolist()}
        worth = {j: float(np.log(p * np.exp(self._gain[i, j]) + 1.0 - p)) for j, p in chances.items()}
        pieces: list[int] = []
        for j in sorted(worth, key=lambda j: -worth[j]):
            if len(pieces) < _MOST_PIECES and not self._is_same[j, pieces].any():
                pieces.append(j)
        plain = sum(worth[j] for j in pieces)
        shared = plain - sum(float(np.log(1.0 - chances[j] + chances[j] * self._failure)) for j in pieces)
        return plain, shared, len(pieces)

    def _odds(self, loop: _Loop, plain: float, shared: float, _num: int) -> float:
        return loop.log_odds + self._penalty(loop) + (shared if loop.is_contradicted else plain)

    def _penalty(self, loop: _Loop) -> float:
        return float(np.log(self._failure)) if loop.is_contradicted else 0.0


def _why(loop: _Loop, opinion: _Opinion) -> str:
    others = f"{opinion.num_agreeing} independent loop{'s' if opinion.num_agreeing != 1 else ''}"
    if loop.is_accepted:
        return f"confirmed by {others}" if opinion.num_agreeing else "no longer contradicted by surer loops"
    speaks = {"odometry": loop.is_contradicted, "surer loops": opinion.is_outweighed}
    witnesses = [name for name, against in speaks.items() if against]
    against = f"contradicted by {' and '.join(witnesses)}" if witnesses else "no longer confirmed"
    return f"{against}, and {others if opinion.num_agreeing else 'no independent loop'} agrees with it"


def last_words(decisions: Iterable[StreamDecision]) -> list[StreamDecision]:
    """Of decisions in their order, the last one on each pair, in the order of the first ones."""
    last = {(d.source_stamp_ns, d.target_stamp_ns): d for d in decisions}
    return list(last.values())


def _ways(poses: Array) -> Array:
    """(N, 2): how far the sensor had come [m] and turned [rad] at each of its poses (N, 4, 4)."""
    steps = se3.invert(poses[:-1]) @ poses[1:]
    moved = np.linalg.norm(steps[:, :3, 3], axis=1)
    turned = np.radians(se3.rotation_angle_deg(steps[:, :3, :3]))
    return np.concatenate([np.zeros((1, 2)), np.cumsum(np.stack([moved, turned], axis=1), axis=0)])


def _apart(this: PlacedLoop, others: Sequence[PlacedLoop]) -> Array:
    """(L,) [m], how far the places of loops are from those of this one, at the end where that is more."""
    ends = ("T_odom_source", "T_odom_target")
    each = [
        np.linalg.norm(np.array([getattr(loop, e)[:3, 3] for loop in others]) - getattr(this, e)[:3, 3], axis=1)
        for e in ends
    ]
    return np.asarray(np.maximum(*each))


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
