"""What the loops of a run say of each other and odometry of each, for one assumption on how far odometry drifts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.pipeline.agreeing.consistency import PlacedLoop, distance_between, fit_to_loops, fit_to_odometry

LEAST_GAIN, MOST_GAIN = float(np.log(3.0)), float(np.log(20.0))  # a corridor that repeats has so many places alike
IN_SIGHT = 2.0  # of the distance up to which a registration may find a pose, so far behind it can be verified
_EXPECTED = 6.0  # squared error of six degrees of freedom


class Relations:
    """Of L loops: gain (L, L), by how much two that agree raise each other's log odds, 0 where they do not; contradicts
    (L, L); is_same (L, L), both are between the same two places; shift_m, sigma_m (L, L), how far apart two are and how
    well one tells the other; by_odometry (L,), whether odometry contradicts each; with_odometry (L,), whether odometry
    over a short way says the same."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self.gain: NDArray[np.float64] = np.zeros((0, 0))
        self.contradicts: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self.is_same: NDArray[np.bool_] = np.zeros((0, 0), bool)
        self.shift_m: NDArray[np.float64] = np.zeros((0, 0))
        self.sigma_m: NDArray[np.float64] = np.zeros((0, 0))
        self.by_odometry: NDArray[np.bool_] = np.zeros(0, bool)
        self.with_odometry: NDArray[np.bool_] = np.zeros(0, bool)

    def add(self, loop: PlacedLoop, others: Sequence[PlacedLoop]) -> None:
        """Take the next loop; others: those that are here."""
        limits, odometry = self._config.loop_closure, fit_to_odometry(loop, self._config)
        self.by_odometry = np.concatenate([self.by_odometry, odometry.contradicts])
        is_short = abs(loop.source_way[0] - loop.target_way[0]) <= IN_SIGHT * limits.max_distance_m
        is_there = (odometry.shift_m <= self._config.sight_view.tolerance_m) & ~odometry.contradicts
        self.with_odometry = np.concatenate([self.with_odometry, is_short & is_there])
        gain, contradicts, is_same = np.zeros(0), np.zeros(0, bool), np.zeros(0, bool)
        shift_m, sigma_m = np.zeros(0), np.zeros(0)
        if others:
            fit = fit_to_loops(loop, others, self._config)
            spread = 2.0 * limits.max_distance_m
            gain = np.minimum(np.log(spread / (np.sqrt(2.0 * np.pi) * fit.sigma_m)), MOST_GAIN)
            gain -= 0.5 * np.maximum(fit.sq_error - _EXPECTED, 0.0)
            gain = np.where(gain >= LEAST_GAIN, gain, 0.0)
            contradicts, shift_m, sigma_m = fit.contradicts, fit.shift_m, fit.sigma_m
            is_same = distance_between(loop, others) < self._config.agreement.independent_m
        self.gain = _grown(self.gain, gain)
        self.contradicts, self.is_same = _grown(self.contradicts, contradicts), _grown(self.is_same, is_same)
        self.shift_m, self.sigma_m = _grown(self.shift_m, shift_m), _grown(self.sigma_m, sigma_m)

    def forget_first(self) -> None:
        """Give up the oldest loop."""
        self.by_odometry, self.with_odometry = self.by_odometry[1:], self.with_odometry[1:]
        self.gain, self.contradicts, self.is_same = self.gain[1:, 1:], self.contradicts[1:, 1:], self.is_same[1:, 1:]
        self.shift_m, self.sigma_m = self.shift_m[1:, 1:], self.sigma_m[1:, 1:]

    def pieces(self, ordered: Sequence[int], most: int | None = None) -> list[int]:
        """Of those loops, in their order, the ones that are not between the same places as an earlier one."""
        found: list[int] = []
        for loop in ordered:
            if len(found) == most:
                break
            if not self.is_same[loop, found].any():
                found.append(loop)
        return found

    def is_pinned(self, loop: int, pieces: Sequence[int], known_m: float) -> bool:
        """Whether the pieces tell within `known_m` where a loop puts its source.

        The loop is one of which nothing but a standard deviation of `known_m` is known; all of them lie within that of
        the pieces.
        """
        return bool(np.sum(1.0 / self._variance(loop, known_m)[pieces]) >= 1.0 / known_m**2)

    def is_told_apart(self, loop: int, sure: Sequence[int], known_m: float) -> bool:
        """Whether something sure tells within `known_m` that such a loop puts its source elsewhere.

        What is open along a direction may have slid there, by less than drift can explain.
        """
        is_close = self._variance(loop, known_m)[sure] <= known_m**2
        return bool((is_close & (self.shift_m[loop, sure] > known_m)).any())

    def _variance(self, loop: int, known_m: float) -> NDArray[np.float64]:
        """(L,), of where the others, and the ways to them, say that its source is."""
        return np.asarray(np.maximum(self.sigma_m[loop] ** 2 - known_m**2, 1e-9))

    def weights(self, alone: NDArray[np.float64], chances: NDArray[np.float64]) -> NDArray[np.float64]:
        """(L,), of each loop the weight of a set that it belongs to, in which no two contradict each other and each
        agrees with another one; loops between the same places weigh once.

        alone: by which sets are begun, the largest first; chances: (L,), what each weighs; those of 0 are in no set.
        """
        weights, counts = np.zeros(len(alone)), chances > 0.0
        for seed in sorted(np.flatnonzero(counts).tolist(), key=lambda i: -alone[i]):
            if weights[seed] > 0.0:
                continue
            members, is_free = [seed], counts & ~self.contradicts[seed]
            is_free[seed] = False
            gain = np.where(is_free, self.gain[seed], 0.0)
            while gain.max() > 0.0:
                best = int(np.argmax(gain * chances))
                members.append(best)
                is_free &= ~self.contradicts[best]
                is_free[best] = False
                gain = np.where(is_free, np.maximum(gain, self.gain[best]), 0.0)
            counted = self.pieces(sorted(members, key=lambda j: -chances[j]))
            weights[members] = np.maximum(weights[members], chances[counted].sum())
        return weights


def _grown(square: NDArray[Any], row: NDArray[Any]) -> NDArray[Any]:
    """With one more row and column; nothing on the diagonal."""
    grown = np.zeros((len(square) + 1, len(square) + 1), square.dtype)
    grown[:-1, :-1], grown[-1, :-1], grown[:-1, -1] = square, row, row
    return grown
