"""What the loops of a run make of each one of them: how likely it is by all that is known, and is it accepted.

Only loops that were accepted on their pair, and that stand, speak for others. Neighbours that fail in the same way are
mostly left undecided, all of them; they would lift each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.config import Config
from svc_ros.core.scan import Array
from svc_ros.pipeline.agreeing.consistency import PlacedLoop
from svc_ros.pipeline.agreeing.less_drift import least_that_does
from svc_ros.pipeline.agreeing.relations import MOST_GAIN, Relations
from svc_ros.pipeline.stream import StreamDecision

_MOST_PIECES = 3  # more evidence than this changes nothing
_LEAST_PIECES = 2  # for a loop that its pair leaves undecided
_FAILURE_BETWEEN = 0.001  # how often two right loops contradict each other, because odometry between them has failed
_LEAST_PROBABILITY, _MOST_PROBABILITY = 1e-3, 0.99


@dataclass(eq=False)
class HeldLoop:
    """raw: the decision on the pair alone; placed: where its ends stand; log_odds: of the pair alone; is_accepted: the
    last word on it; has_outlived: a loop that agreed with it is not kept any longer."""

    raw: StreamDecision
    placed: PlacedLoop
    log_odds: float
    is_accepted: bool = False
    has_outlived: bool = False

    @property
    def was_accepted(self) -> bool:
        return self.raw.result.accepted


@dataclass(frozen=True)
class Opinion:
    """num_pieces: how many independent loops agree; is_contradicted: by odometry; is_outweighed: by surer loops;
    is_with_odometry: odometry over a short way has confirmed what the pair alone left undecided."""

    is_accepted: bool
    log_odds: float
    num_pieces: int
    is_contradicted: bool
    is_outweighed: bool
    is_with_odometry: bool = False


@dataclass(frozen=True, eq=False)
class _Support:
    """plain: log odds that loops add which agree; shared: the same where odometry must have failed for all of them;
    pieces: numbers of those that count, independent of each other."""

    plain: float
    shared: float
    pieces: list[int]


class Weighing:
    """Of L loops and what they say of each other, for each assumption on drift, the least first.

    wanted: log odds from which a loop is accepted.
    """

    def __init__(
        self, config: Config, wanted: float, loops: Sequence[HeldLoop], relations: Sequence[Relations]
    ) -> None:
        self._loops, self._assumptions, self._wanted = loops, relations, wanted
        self._known_m, self._failure = config.sight_view.tolerance_m, config.agreement.odometry_failure
        self._log_odds = np.array([loop.log_odds for loop in loops])
        self._was_accepted = np.array([loop.was_accepted for loop in loops], bool)

    def opinions(self) -> list[Opinion]:
        """(L,), by those that were accepted on their pair and stand: what falls speaks for none."""
        speaks = self._was_accepted.copy()
        relations, support, alone, weights = self._assume(speaks)
        while True:
            found = self._weigh_accepted(relations, support, alone, weights)
            falls = speaks.copy()
            sure = [i for i, opinion in found.items() if opinion.is_accepted]
            falls[sure] = False
            if not (relations.gain[np.ix_(sure, np.flatnonzero(falls))] > 0.0).any():
                break
            speaks &= ~falls
            support = self._supports(relations, speaks)
        for i in np.flatnonzero(~self._was_accepted).tolist():
            found[i] = self._weigh_undecided(i, relations, sure)
        return [found[i] for i in range(len(self._loops))]

    def _weigh_accepted(
        self, relations: Relations, supports: dict[int, _Support], alone: Array, weights: Array
    ) -> dict[int, Opinion]:
        """Those accepted on their pair: the largest sets first, each loop against those of them that it contradicts."""
        found: dict[int, Opinion] = {}
        for i in sorted(supports, key=lambda i: (-weights[i], -alone[i])):
            support = supports[i]
            odds = self._odds(i, relations, support)
            against = [o.log_odds for j, o in found.items() if o.is_accepted and relations.contradicts[i, j]]
            if against:
                # What fools one loop may fool its neighbours: against surer ones they all are one piece of evidence.
                doubt = np.log(_FAILURE_BETWEEN + (1.0 - _FAILURE_BETWEEN) * probability(-max(against)))
                odds = min(odds, float(self._log_odds[i] + min(support.plain, MOST_GAIN) + doubt))
            found[i] = self._opinion(i, relations, support, odds, bool(against))
        return found

    def _weigh_undecided(self, i: int, relations: Relations, sure: list[int]) -> Opinion:
        """One that its pair left undecided, by the accepted ones that stand.

        It needs two independent loops that say the same of it, or one together with odometry and its own pair; closely,
        for along a direction that is open it may have slid; and none that contradicts it. Over a short way odometry
        alone does for a likely one: it fails rarely, and what says the same as it does no harm where it has failed.
        """
        speaks = np.zeros(len(self._loops), bool)
        speaks[sure] = relations.shift_m[i, sure] <= self._known_m
        support, is_outweighed = self._support(i, relations, speaks), bool(relations.contradicts[i, sure].any())
        is_likely = self._log_odds[i] >= 0.0 and not relations.by_odometry[i]
        is_told_apart = relations.is_told_apart(i, sure, self._known_m)
        is_confirmed = len(support.pieces) >= (1 if is_likely else _LEAST_PIECES) and relations.is_pinned(
            i, support.pieces, self._known_m
        )
        is_with_odometry = bool(is_likely and relations.with_odometry[i] and not is_confirmed)
        odds = self._odds(i, relations, support) - is_with_odometry * float(np.log(self._failure))
        if is_outweighed or is_told_apart or not (is_confirmed or is_with_odometry):
            odds = -np.inf
        opinion = self._opinion(i, relations, support, odds, is_outweighed)
        return replace(opinion, is_with_odometry=is_with_odometry)

    def _opinion(self, i: int, relations: Relations, support: _Support, odds: float, is_outweighed: bool) -> Opinion:
        """Accepted where the odds suffice; and where it was, with the help of loops that have gone since."""
        loop = self._loops[i]
        keeps_its_verdict = loop.has_outlived and loop.is_accepted and not is_outweighed
        is_accepted = odds >= self._wanted or keeps_its_verdict
        return Opinion(is_accepted, odds, len(support.pieces), bool(relations.by_odometry[i]), is_outweighed)

    def _assume(self, speaks: NDArray[np.bool_]) -> tuple[Relations, dict[int, _Support], Array, Array]:
        """With how little drift the loops still agree about as well as with all that is possible: relations, support,
        log odds by that alone, and weights."""
        chances = np.where(speaks, probability(self._log_odds), 0.0)
        found = []
        for relations in self._assumptions:
            support, alone = self._supports(relations, speaks), np.zeros(len(self._loops))
            for i, each in support.items():
                alone[i] = self._odds(i, relations, each)
            found.append((relations, support, alone, relations.weights(alone, chances)))
        heaviest = [float(weights.max()) for *_, weights in found]
        return least_that_does(found, heaviest, heaviest[-1])

    def _supports(self, relations: Relations, speaks: NDArray[np.bool_]) -> dict[int, _Support]:
        """Of each loop that was accepted on its pair."""
        return {i: self._support(i, relations, speaks) for i in np.flatnonzero(self._was_accepted).tolist()}

    def _support(self, i: int, relations: Relations, speaks: NDArray[np.bool_]) -> _Support:
        """What independent loops say for one; speaks: (L,), those that are asked."""
        partners = np.flatnonzero(speaks & (relations.gain[i] > 0.0) & ~relations.is_same[i])
        if not len(partners):
            return _Support(0.0, 0.0, [])
        odds = self._log_odds[partners]
        if not relations.by_odometry[i]:  # else odometry has failed for all of them at once, see `_odds`
            odds = odds + np.log(self._failure) * relations.by_odometry[partners]
        chances = probability(odds)
        worth = np.log(chances * np.exp(relations.gain[i, partners]) + 1.0 - chances)
        order = np.argsort(-worth, kind="stable")
        pieces = relations.pieces(partners[order].tolist(), _MOST_PIECES)
        counted = np.searchsorted(partners, np.array(pieces, np.int64))
        plain = float(worth[counted].sum())
        shared = plain - float(np.log(1.0 - chances[counted] + chances[counted] * self._failure).sum())
        return _Support(plain, shared, pieces)

    def _odds(self, i: int, relations: Relations, support: _Support) -> float:
        """With the word of odometry, which where it failed did so for all loops at once."""
        if relations.by_odometry[i]:
            return float(self._log_odds[i] + np.log(self._failure)) + support.shared
        return float(self._log_odds[i]) + support.plain


def log_odds_of(chance: float) -> float:
    """Of a probability, neither of which is ever certain."""
    p = min(max(chance, _LEAST_PROBABILITY), _MOST_PROBABILITY)
    return float(np.log(p / (1.0 - p)))


def probability(log_odds: float | Array) -> Array:
    """The other way round."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.asarray(log_odds))))
