"""Where in a map a scan may have been taken, without a guess; and whether later scans agree.

One scan cannot tell two rooms apart that look alike, a run of them can: what one scan alone is not sure of waits here
until others, some metres on, have said the same along odometry and sight lines have denied it nowhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from svc_ros.core import se3
from svc_ros.core.config import Config
from svc_ros.core.registration import verify
from svc_ros.core.scan import Array
from svc_ros.pipeline.decide import register_pair
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.neighbours import KeyframeMap, Placed, is_same_place, judge_among_neighbours, place_against

_LOOKED_THROUGH = 8  # times the wanted keyframes, for those far from each other
DRIFT = 0.02  # odometry's error grows by so much for each metre
_MOST = 8  # places that wait at once


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
    """Where the sensor may be. T_map_odom: (4, 4); stood_at: (K, 3) [m] in the odometry frame, of scans that said so;
    num_silent: scans since then that neither confirmed nor denied it."""

    T_map_odom: Array
    latest: Placed
    stood_at: list[Array]
    num_silent: int = 0


class WaitingPlaces:
    """Places that scans have said they may have been taken at, until one of them is sure."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._places: list[_Place] = []

    def __len__(self) -> int:
        return len(self._places)

    def clear(self) -> None:
        """Forget all of them."""
        self._places.clear()

    def ask(self, T_odom_scan: Array, judge: Callable[[Array], Placed]) -> None:
        """Let the next scan judge where each place says that it was taken; what it denies is forgotten."""
        left = []
        for place in self._places:
            placed = judge(place.T_map_odom @ T_odom_scan)
            if placed.is_denied:
                continue
            place.num_silent += 1
            if self._counts(placed):
                self._support(place, placed, T_odom_scan)
            if place.num_silent <= len(place.stood_at):
                left.append(place)
        self._places = left

    def add(self, found: Iterable[Placed], T_odom_scan: Array) -> None:
        """Take poses that a search for the same scan has found; those that are not probable enough say nothing."""
        for placed in filter(self._counts, found):
            same = [p for p in self._places if self._is_same(p, placed, T_odom_scan)]
            if same:
                self._support(same[0], placed, T_odom_scan)
            else:
                T_map_odom = placed.T_map_scan @ se3.invert(T_odom_scan)
                self._places = [_Place(T_map_odom, placed, [T_odom_scan[:3, 3]]), *self._places[: _MOST - 1]]

    def settled(self, found: Iterable[Placed]) -> Placed | None:
        """The pose of the last scan in the only place that is left, if that scan or enough of them are sure of it.

        found: what the search for that scan has found.
        """
        if len(self._places) != 1:
            return None
        (place,) = self._places
        limits = self._config.localization
        is_found = any(is_same_place(place.latest.T_map_scan, p.T_map_scan, self._config) for p in found)
        is_sure = is_found and place.latest.probability >= limits.sure_probability
        is_agreed = place.num_silent == 0 and len(place.stood_at) >= limits.agreeing_scans
        return place.latest if is_sure or is_agreed else None

    def describe(self) -> str:
        """How far they are, for a person."""
        scans = max((len(place.stood_at) for place in self._places), default=0)
        wanted = self._config.localization.agreeing_scans
        return f"{scans} of {wanted} scans that have to agree, {len(self._places)} places are possible"

    def _counts(self, placed: Placed) -> bool:
        return placed.result.accepted and placed.probability >= self._config.localization.min_probability

    def _support(self, place: _Place, placed: Placed, T_odom_scan: Array) -> None:
        place.T_map_odom = placed.T_map_scan @ se3.invert(T_odom_scan)
        place.latest, place.num_silent = placed, 0
        apart = np.linalg.norm(np.array(place.stood_at) - T_odom_scan[:3, 3], axis=1)
        if float(apart.min()) >= self._config.localization.agreeing_distance_m:
            place.stood_at.append(T_odom_scan[:3, 3])

    def _is_same(self, place: _Place, placed: Placed, T_odom_scan: Array) -> bool:
        way_m = float(np.linalg.norm(place.stood_at[-1] - T_odom_scan[:3, 3]))
        return is_same_place(place.T_map_odom @ T_odom_scan, placed.T_map_scan, self._config, DRIFT * way_m)
