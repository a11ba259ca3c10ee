"""The default method's search: three looks, each dearer than the one before, until one finds a pose that is accepted.

First the poses that matches of a part of the points agree on. Then, where both scans see the ground, every turn about
the vertical and every shift; if neither look leads to a pose that promises anything, the scans show different places.
Last the matches of all points, and many more of their poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core.matches.matcher import Matcher
from svc_ros.core.pair import Pair
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Correspondences, HypothesisSet
from svc_ros.core.scans.levelling import Level
from svc_ros.core.search import shortlist
from svc_ros.core.search.hypotheses import generate_hypotheses, pool_hypotheses
from svc_ros.core.search.levelled_poses import find_levelled_poses
from svc_ros.core.selection import choose_best, dismiss, look_roughly

_HOPELESS = float(np.log(8.0))  # a pose that promises less by this can neither win nor cast doubt on the winner
_PROMISING = -6.0  # log odds after a rough look; no right pose between level scans was seen to promise less
_LAST_TRIES = 2  # poses that are looked at closely even so, before scans are told to show different places


@dataclass(frozen=True, eq=False)
class RoughPoses:
    """Poses (S, 4, 4) after a rough look, and the log odds (S,) that they promise; best first."""

    T_target_source: Array
    promise: Array

    def __len__(self) -> int:
        return len(self.promise)

    @property
    def promising(self) -> bool:
        """Whether one of them may be right, as far as few points tell."""
        return len(self) > 0 and bool(self.promise[0] > _PROMISING)

    def contenders(self) -> Array:
        """Those (S, 4, 4) that may win, or cast doubt on the winner."""
        return np.asarray(self.T_target_source[self.promise > self.promise[0] - _HOPELESS])


def find_pose(pair: Pair, matcher: Matcher) -> RegistrationResult:
    """Look, up to three times, until a pose is accepted; else the best of all that was seen, judged."""
    # First look: what a part of the points agrees on; that is enough for most pairs.
    seen = _look_at_few(pair, matcher.few())
    if seen.promising or (len(seen) > 0 and not _level(pair, matcher)):
        result = choose_best(pair, seen.contenders())
        if result.accepted:
            return result
    # Second look: every turn and shift on the ground. If nothing is seen now, there is nothing to be seen.
    if levels := _level(pair, matcher):
        seen = _join(pair, seen, _look_at_levelled(pair, levels))
        if seen.promising:
            result = choose_best(pair, seen.contenders())
            if result.accepted:
                return result
        elif all(level.sure for level in levels) and not pair.config.matching.more_descriptors:
            dismissed = dismiss(pair, seen.T_target_source[:_LAST_TRIES])
            if dismissed is not None:
                return dismissed
    # Last look: the matches of all points, thresholds further apart, many more poses.
    matches = matcher.all()
    seen = _join(pair, seen, _look_at_all(pair, matches))
    if len(seen) == 0:
        return pair.unanswered(matches)
    return choose_best(pair, seen.T_target_source[: pair.config.shortlist.max_poses])


def _level(pair: Pair, matcher: Matcher) -> list[Level]:
    """How both scans stand on the ground; empty where a second look has nothing to go by."""
    return [] if matcher.alone else pair.levels()


def _look_at_few(pair: Pair, matches: list[Correspondences]) -> RoughPoses:
    """The best distinct poses of these matches."""
    return _look_at_shortlist(pair, pair.hypotheses(matches, generate_hypotheses), matches, 0)


def _look_at_all(pair: Pair, matches: list[Correspondences]) -> RoughPoses:
    """The best of many hypotheses, each refined and looked at roughly, with few points of both scans.

    At low overlap a right pose has hardly more inliers or overlap than wrong ones; its free sight lines tell it.
    """
    more = pair.config.shortlist.rough_poses
    return _look_at_shortlist(pair, pair.hypotheses(matches, pool_hypotheses), matches, more)


def _look_at_shortlist(pair: Pair, hypotheses: HypothesisSet, matches: list[Correspondences], more: int) -> RoughPoses:
    """The shortlist, and `more` hypotheses by how far the scans agree, all looked at roughly."""
    if len(hypotheses) == 0:
        return _NONE
    config = pair.config
    with pair.watch.stage("shortlist"):
        by_agreement = shortlist.order_by_agreement(hypotheses.T_target_source, pair.source, pair.target, config)
        starts = shortlist.shortlist(hypotheses, Correspondences.of_all(matches), by_agreement, config)
        wide = by_agreement[shortlist.select_distinct(by_agreement, config.shortlist, more)]
    with pair.watch.stage("rough_look"):
        return _rough(pair, np.concatenate((starts, wide)))


def _look_at_levelled(pair: Pair, levels: list[Level]) -> RoughPoses:
    """The best turns and shifts of two scans that see the ground."""
    with pair.watch.stage("levelled"):
        starts = find_levelled_poses(pair.source, pair.target, levels, pair.config.hypotheses.levelled_poses)
    with pair.watch.stage("rough_look"):
        return _rough(pair, starts)


def _rough(pair: Pair, starts: Array) -> RoughPoses:
    pair.counts["searched"] = pair.counts.get("searched", 0) + len(starts)
    return RoughPoses(*look_roughly(pair, starts))


def _join(pair: Pair, *looks: RoughPoses) -> RoughPoses:
    """The distinct ones of all, best first."""
    T = np.concatenate([look.T_target_source for look in looks])
    promise = np.concatenate([look.promise for look in looks])
    order = np.argsort(-promise, kind="stable")
    order = order[shortlist.select_distinct(T[order], pair.config.shortlist, len(order))]
    return RoughPoses(T[order], promise[order])


_NONE = RoughPoses(np.zeros((0, 4, 4)), np.zeros(0))
