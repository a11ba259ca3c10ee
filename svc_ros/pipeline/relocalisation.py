"""Where in a map a scan may have been taken, without a guess; and whether later scans agree.

One scan cannot tell two rooms apart that look alike, a run of them can: what one scan alone is not sure of waits here
until others, some metres on, say the same along odometry. Every place is judged by the same scans, also by those that
came before it was found: of two that look alike, the one that was found first has no advantage.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.decision import measure_margins
from svc_ros.core.registration import verify
from svc_ros.core.scan import Array
from svc_ros.pipeline.decide import register_pair
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.neighbours import KeyframeMap, Placed, is_same_place, judge_among_neighbours, place_against

_LOOKED_THROUGH = 8  # times the wanted keyframes, for those far from each other
DRIFT = 0.02  # odometry's error grows by so much for each metre
_MOST = 8  # places that wait at once
_CHANCE = math.log(2000.0)  # odds against: a search looks at so many poses, and finds one of them by chance


def find_in_map(this: Keyframe, keyframes: KeyframeMap, guesses: Iterable[Array], config: Config) -> list[Placed]:
    """The distinct poses of a scan in the map that are accepted, the most probable first.

    Registered to the keyframes whose places look most like its own, and to the nearest one of each guess (4, 4); a
    keyframe that confirms a pose found before is not asked for one of its own. Where no pose is accepted, the one that
    came nearest to it; nothing where there is nothing to register to.
    """
    found: list[Placed] = []
    failed: list[Placed] = []
    near = [index for guess in guesses for index in keyframes.near(guess, config.preprocess.max_range_m, 1)]
    for index in dict.fromkeys([*near, *_alike(this, keyframes, config)]):
        if any(_confirms(this, placed, keyframes, index, config) for placed in found):
            continue
        placed = _registered(this, keyframes, index, config)
        if not placed.result.accepted:
            failed.append(placed)
        elif not any(is_same_place(placed.T_map_scan, other.T_map_scan, config) for other in found):
            found.append(placed)
    best = max(failed, key=lambda placed: placed.probability, default=None)
    return sorted(found, key=lambda placed: -placed.probability) or ([] if best is None else [best])


def _alike(this: Keyframe, keyframes: KeyframeMap, config: Config) -> list[int]:
    """The keyframes that look most like the scan; every other one far from those before it.

    Where one place looks like the scan, those beside it do, too, and would leave no turn for another that does.
    """
    most = config.localization.max_similar
    left = [index for index, _ in keyframes.similar(this.look, _LOOKED_THROUGH * most)]
    chosen: list[int] = []
    while left and len(chosen) < most:
        ways = np.linalg.norm(keyframes.poses[left, None, :3, 3] - keyframes.poses[chosen, :3, 3], axis=2)
        far = np.flatnonzero((ways >= config.loop_closure.max_distance_m).all(axis=1))
        chosen.append(left.pop(int(far[0]) if len(chosen) % 2 and len(far) else 0))
    return chosen


def _confirms(this: Keyframe, placed: Placed, keyframes: KeyframeMap, index: int, config: Config) -> bool:
    with keyframes.keyframe(index).lent() as target:
        T = se3.invert(keyframes.poses[index]) @ placed.T_map_scan
        return verify(this.scan, target.scan, T, config).accepted


def _registered(this: Keyframe, keyframes: KeyframeMap, index: int, config: Config) -> Placed:
    """What a registration finds, if one keyframe accepts it as its neighbours judge it."""
    with keyframes.keyframe(index).lent() as target:
        placed = place_against(this, register_pair(this.features, target.features, config), keyframes, index, target)
    if not placed.result.accepted:
        return placed
    return judge_among_neighbours(this, placed.T_map_scan, keyframes, config)


@dataclass(eq=False)
class _Place:
    """Where the sensor may be. T_map_odom: (4, 4); latest: what the last scan that said so made of it; agreeing:
    numbers of the kept scans that say so, and the log odds of what they deny; denying: numbers of those that deny it;
    num_silent: scans since one said so."""

    T_map_odom: Array
    latest: Placed
    agreeing: dict[int, float] = field(default_factory=dict)
    denying: set[int] = field(default_factory=set)
    num_silent: int = 0

    @property
    def balance(self) -> int:
        """How many more of the kept scans agree than deny."""
        return len(self.agreeing) - len(self.denying)

    @property
    def odds(self) -> float:
        """Log odds by what is denied, of the kept scans that agree, in the mean."""
        return sum(self.agreeing.values()) / max(len(self.agreeing), 1)


class WaitingPlaces:
    """Places that scans have said they may have been taken at, until one of them is sure; for one thread at a time.

    judge: what a scan makes of a pose (4, 4) of its own in the map. Scans that come in have their `T_odom_scan`.
    """

    def __init__(self, config: Config, judge: Callable[[Keyframe, Array], Placed]) -> None:
        self._config, self._judge = config, judge
        self._places: list[_Place] = []
        self._scans: dict[int, Keyframe] = {}  # the last ones that stood apart, by number
        self._spot = 0  # the number of the one that stood where the last scan did

    def __len__(self) -> int:
        return len(self._places)

    def clear(self) -> None:
        """Forget all of them."""
        self._places.clear()
        self._scans.clear()

    def ask(self, this: Keyframe) -> None:
        """Let the next scan judge where each place says that it was taken; what it denies is forgotten."""
        self._keep(this)
        left = []
        for place in self._places:
            placed = self._judge(this, place.T_map_odom @ _odom(this))
            if placed.is_denied:
                continue
            place.num_silent += 1
            if self._counts(placed):
                self._support(place, placed, this)
            if place.num_silent <= max(len(place.agreeing), 1):
                left.append(place)
        self._places = left

    def add(self, found: Iterable[Placed], this: Keyframe) -> None:
        """Take poses that a search for the same scan has found; those that are not probable enough say nothing."""
        for placed in filter(self._counts, found):
            same = [place for place in self._places if self._is_same(place, placed, this)]
            if same:
                self._support(same[0], placed, this)
            else:
                self._places.append(self._new(placed, this))
        self._places = sorted(self._places, key=lambda place: -place.balance)[:_MOST]

    def settled(self, found: Iterable[Placed]) -> tuple[Placed, bool] | None:
        """The pose of the last scan in a place that it, alone, or enough scans are sure of; and whether it is alone.

        found: what the search for that scan has found.
        """
        if not self._places:
            return None
        first, *others = self._places
        limits = self._config.localization
        # The others were judged by the same scans: one that most of these do not know is no rival.
        near = first.balance - limits.agreeing_scans + 1
        rivals = [place for place in others if place.num_silent == 0 or place.balance > near]
        is_agreed = first.num_silent == 0 and first.balance >= limits.agreeing_scans and not rivals
        # What looks like the place looks so to the next scan, too: they count as the root of their number.
        if is_agreed and math.sqrt(len(first.agreeing)) * first.odds >= _CHANCE:
            return first.latest, False
        is_found = any(is_same_place(first.latest.T_map_scan, p.T_map_scan, self._config) for p in found)
        is_alone = is_found and not others and not first.denying and self._is_sure(first.latest)
        return (first.latest, True) if is_alone else None

    def describe(self) -> str:
        """How far they are, for a person."""
        scans = max((place.balance for place in self._places), default=0)
        wanted = self._config.localization.agreeing_scans
        return f"{scans} of {wanted} scans that have to agree, {len(self._places)} places are possible"

    def _keep(self, this: Keyframe) -> None:
        """Keep a scan that stood apart from those that are kept; one that did not speaks for the one beside it."""
        ways = {k: float(np.linalg.norm((_odom(this) - _odom(kept))[:3, 3])) for k, kept in self._scans.items()}
        nearest = min(ways, key=lambda k: ways[k], default=None)
        if nearest is not None and ways[nearest] < self._config.localization.agreeing_distance_m:
            self._spot = nearest
            return
        self._spot = max(self._scans, default=0) + 1
        self._scans[self._spot] = this
        if len(self._scans) >= 2 * self._config.localization.agreeing_scans:
            oldest = min(self._scans)
            del self._scans[oldest]
            for place in self._places:
                place.agreeing.pop(oldest, None)
                place.denying.discard(oldest)

    def _new(self, placed: Placed, this: Keyframe) -> _Place:
        """A place that a scan has found, as the scans before see it."""
        place = _Place(placed.T_map_scan @ se3.invert(_odom(this)), placed, {self._spot: self._odds(placed)})
        for number, earlier in self._scans.items():
            if number == self._spot:
                continue
            judged = self._judge(earlier, place.T_map_odom @ _odom(earlier))
            if judged.is_denied:
                place.denying.add(number)
            elif self._counts(judged):
                place.agreeing[number] = self._odds(judged)
        return place

    def _counts(self, placed: Placed) -> bool:
        return placed.result.accepted and placed.probability >= self._config.localization.min_probability

    def _is_sure(self, placed: Placed) -> bool:
        is_probable = placed.probability >= self._config.localization.sure_probability
        return is_probable and self._odds(placed) >= _CHANCE

    def _odds(self, placed: Placed) -> float:
        """Log odds of a judged pose by what is denied; unlike its probability these do not end where overlap does."""
        evidence = placed.result.evidence
        return 0.0 if evidence is None else measure_margins(evidence, self._config.decision).seen

    def _support(self, place: _Place, placed: Placed, this: Keyframe) -> None:
        place.T_map_odom = placed.T_map_scan @ se3.invert(_odom(this))
        place.latest, place.num_silent = placed, 0
        place.agreeing[self._spot] = self._odds(placed)
        place.denying.discard(self._spot)

    def _is_same(self, place: _Place, placed: Placed, this: Keyframe) -> bool:
        T_map_before = place.latest.T_map_scan
        T_map_this = place.T_map_odom @ _odom(this)
        way_m = float(np.linalg.norm((T_map_this - T_map_before)[:3, 3]))
        return is_same_place(T_map_this, placed.T_map_scan, self._config, DRIFT * way_m)


def _odom(scan: Keyframe) -> Array:
    assert scan.T_odom_scan is not None
    return scan.T_odom_scan
