"""Pairs of scans that are kept for a person to look at in three dimensions: few, thin, and the ones worth a look."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svc_ros.core import se3
from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, IndexArray, PreparedScan
from svc_ros.core.sight.evidence import SeenSurface, SightLines
from svc_ros.report.sight_lines import choose_denied, choose_evenly, choose_lines

MAX_POINTS = 5000  # of each scan: more are not told apart on a screen

Points = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SideView:
    """What is drawn of one scan of a pair, all of it (N, 3) [m] in the target's frame.

    points: the thinned scan; origin: (3,), where its sensor stood; clear, blocked: ends of sight lines that start
    there; denied: its points where the *other* scan's sensor looked through; num_points, num_lines, num_blocked,
    num_denied: how many there were before thinning; num_seen: points that the other sensor denied or confirmed.
    """

    points: Points
    origin: Points
    clear: Points
    blocked: Points
    denied: Points
    num_points: int
    num_lines: int
    num_blocked: int
    num_denied: int
    num_seen: int


@dataclass(frozen=True, eq=False)
class Scene:
    """One decision in three dimensions.

    index: number of its decision, from 0, later words on loops not counted; T_target_source: (4, 4), the
    pose that was judged, right or not; None where there was none: the source then stands in its own frame.
    """

    index: int
    target: SideView
    source: SideView
    T_target_source: Array | None

    @property
    def num_blocked_drawn(self) -> int:
        """Red sight lines in the picture."""
        return len(self.target.blocked) + len(self.source.blocked)

    @property
    def num_denied_drawn(self) -> int:
        """Red points in the picture."""
        return len(self.target.denied) + len(self.source.denied)


def make_scene(index: int, source: PreparedScan, target: PreparedScan, result: RegistrationResult) -> Scene:
    """Thin copies of both scans, placed by the judged pose, with the evidence's sight lines and denied surface.

    Raises InputError where the evidence belongs to other scans, or tells only how many lines and points there are.
    """
    evidence, T = result.evidence, result.best_candidate
    if evidence is None or T is None:
        return Scene(index, _side(target, np.eye(4), None), _side(source, np.eye(4) if T is None else T, None), T)
    of_target = evidence.source_in_target, evidence.target_surface
    of_source = evidence.target_in_source, evidence.source_surface
    return Scene(index, _side(target, np.eye(4), of_target), _side(source, T, of_source), T)


def _side(scan: PreparedScan, T_target_scan: Array, seen: tuple[SightLines, SeenSurface] | None) -> SideView:
    """seen: the scan's own sight lines, and its surface as the other sensor saw it."""

    def placed(idx: IndexArray) -> Points:
        return se3.apply(T_target_scan, scan.points[idx]).astype(np.float32)

    num = len(scan)
    shown = placed(choose_evenly(np.arange(num), MAX_POINTS))
    origin = se3.apply(T_target_scan, scan.sensor_origin[None])[0].astype(np.float32)
    if seen is None:
        nothing = np.zeros((0, 3), np.float32)
        return SideView(shown, origin, nothing, nothing, nothing, num, 0, 0, 0, 0)
    lines, surface = seen
    for name, idx in (("blocked", lines.blocked_idx), ("denied", surface.denied_idx)):
        _check_indices(name, idx, num)
    clear, blocked = (placed(idx) for idx in choose_lines(lines, num))
    denied = placed(choose_denied(surface))
    num_seen = surface.num_denied + surface.num_confirmed
    return SideView(
        shown, origin, clear, blocked, denied, num, lines.num_lines, lines.num_blocked, surface.num_denied, num_seen
    )


def _check_indices(name: str, idx: IndexArray, num: int) -> None:
    if len(idx) and not (idx.min() >= 0 and idx.max() < num):
        raise InputError(
            f"scene: expected {name} indices from 0 to {num - 1}, found {idx.min()} to {idx.max()}: "
            "the evidence is not of these scans, or was read from JSON, which keeps no indices"
        )


class SceneKeeper:
    """Chooses the scenes of a run while it goes on, in bounded memory and the same ones each time.

    Kept are decisions that were not accepted, those nearest to acceptance first and the rest spread over the run, and
    accepted ones, the least sure and again a spread. One kind leaves its places to the others where it is rare.
    """

    def __init__(self, max_scenes: int = 60) -> None:
        if max_scenes < 1:
            raise InputError(f"scenes: expected to keep at least one, found {max_scenes}")
        self._max = max_scenes
        self._pools: dict[bool, tuple[_Doubtful, _Spread]] = {
            accepted: (_Doubtful(max_scenes), _Spread(max_scenes)) for accepted in (False, True)
        }
        self._scenes: dict[int, Scene] = {}

    def offer(self, index: int, source: PreparedScan, target: PreparedScan, result: RegistrationResult) -> None:
        """Take thin copies of a decision's scans, or leave it; index: its line in decisions.jsonl, from 0."""
        doubtful, spread = self._pools[result.accepted]
        probability = 0.5 if result.probability is None else result.probability
        doubt = 1.0 - probability if result.accepted else probability
        taken = [doubtful.take(index, doubt), spread.take(index)]
        if any(taken):
            self._scenes[index] = make_scene(index, source, target, result)
            held = {k for pools in self._pools.values() for pool in pools for k in pool.held()}
            self._scenes = {k: scene for k, scene in self._scenes.items() if k in held}

    @property
    def scenes(self) -> list[Scene]:
        """At most `max_scenes` of what was offered, in the order of their indices."""
        orders = [pool.held() for pools in self._pools.values() for pool in pools]
        chosen: dict[int, None] = {}
        for share in (0.25, 0.5, 1.0):  # every kind gets its quarter before one gets more
            for order in orders:
                for k in order[: max(1, round(share * self._max))]:
                    if len(chosen) < self._max:
                        chosen[k] = None
        return [self._scenes[k] for k in sorted(chosen)]


class _Doubtful:
    """The indices with the largest doubt; of equal doubt the earlier ones."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._heap: list[tuple[float, int]] = []

    def take(self, index: int, doubt: float) -> bool:
        entry = (doubt, -index)
        if len(self._heap) < self._capacity:
            heapq.heappush(self._heap, entry)
            return True
        return heapq.heappushpop(self._heap, entry) != entry

    def held(self) -> list[int]:
        """Most doubtful first."""
        return [-negative for _, negative in sorted(self._heap, reverse=True)]


class _Spread:
    """Every so-many-th index, the step doubling whenever there are too many."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._step, self._num_seen = 1, 0
        self._kept: list[int] = []

    def take(self, index: int) -> bool:
        number, self._num_seen = self._num_seen, self._num_seen + 1
        if number % self._step:
            return False
        self._kept.append(index)
        if len(self._kept) <= self._capacity:
            return True
        self._kept, self._step = self._kept[::2], 2 * self._step
        return self._kept[-1] == index

    def held(self) -> list[int]:
        """In an order in which every beginning is spread over the run: halves before quarters."""
        num = len(self._kept)
        order = sorted(range(num), key=lambda k: (-(k & -k) if k else -num, k))
        return [self._kept[k] for k in order]
