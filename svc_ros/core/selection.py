"""How the default method judges poses: refined, looked at along the sight lines of both scans, the best decided on.

Others may cast doubt on it: different poses, the same shifted where the surfaces hardly resist, and turned by half.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core import decision
from svc_ros.core.pair import Pair
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.result import RegistrationResult, Verdict
from svc_ros.core.scan import Array
from svc_ros.core.se3 import half_turn, pose_error
from svc_ros.core.search import icp, shortlist
from svc_ros.core.search.prescore import thinned_scan
from svc_ros.core.sight.evidence import SightViewEvidence
from svc_ros.core.sight.observability import SurfaceContact, shift
from svc_ros.core.sight.placement import place
from svc_ros.core.sight.sight_view import glance, index

_NOTHING_MUCH = 0.025  # denied share up to which an accepted pose is not held against its half turns


def look_roughly(pair: Pair, starts: Array) -> tuple[Array, Array]:
    """Poses (S, 4, 4) after ICP with a few hundred points, and what they promise (S,) with few points of both scans.

    Best first. Few points overstate what is denied, of all poses alike: they rank, and only far apart they tell.
    """
    limits, view = pair.config.shortlist, pair.config.sight_view
    source, target = (thinned_scan(scan, limits.rough_view_points) for scan in (pair.source, pair.target))
    index((source, target), view)
    icp.index(pair.target, pair.config)

    def look(start: Array) -> tuple[Array, float]:
        refined = icp.refine_roughly(start, pair.source, pair.target, pair.config)
        return refined, pair.promise(glance(source, target, refined, view))

    T, promise = (np.array(values) for values in zip(*on_all_processors(look, starts), strict=True))
    order = np.argsort(-promise, kind="stable")
    return T[order], promise[order]


def choose_best(pair: Pair, starts: Array) -> RegistrationResult:
    """Refine poses (S, 4, 4), look along the sight lines of each, judge the best; the others may cast doubt on it."""
    limits = pair.config.shortlist
    refined = np.array([pair.refine(T, limits.icp_points) for T in starts])
    pair.counts["judged"] = pair.counts.get("judged", 0) + len(refined)
    evidence = pair.glance_at_all(list(refined))
    settled = _settle(pair, refined[int(np.argmax([pair.promise(e) for e in evidence]))])
    near = shortlist.find_near(refined, settled.T_target_source, limits)
    return _judge(pair, settled, [e for e, same in zip(evidence, near, strict=True) if not same])


def dismiss(pair: Pair, starts: Array) -> RegistrationResult | None:
    """The verdict on poses (S, 4, 4) that promise nothing, by the best of them; None if that is accepted after all."""
    limits = pair.config.shortlist
    refined = [pair.refine(T, limits.icp_points) for T in starts]
    pair.counts["judged"] = pair.counts.get("judged", 0) + len(refined)
    T = max(zip(map(pair.promise, pair.glance_at_all(refined)), refined, strict=True), key=lambda item: item[0])[1]
    evidence, contact = pair.look_and_touch(T)
    decided = decision.decide(evidence, pair.config.decision)
    return None if decided.verdict is Verdict.ACCEPTED else pair.answer(T, evidence, decided, contact)


def verify_svc(pair: Pair, T: Array) -> RegistrationResult:
    """Refine the pose and judge it; one that refinement moves away is not the pose that was asked about."""
    refined = pair.refine(T, pair.config.shortlist.icp_last_points)
    angle, distance = pose_error(refined, T)
    limits = pair.config.shortlist
    if angle > limits.max_moved_rotation_deg or distance > limits.max_moved_translation_m:
        evidence, contact = pair.look_and_touch(T)
        return pair.answer(T, evidence, decision.moved_away(angle, distance), contact)
    evidence, contact = pair.look_and_touch(refined)
    if decision.decide(evidence, pair.config.decision).verdict is not Verdict.ACCEPTED:
        return _judge(pair, Settled(refined, evidence, contact, [], []), [])
    return _judge(pair, _with_slips(pair, refined, evidence, contact), [])


@dataclass(frozen=True, eq=False)
class Settled:
    """A refined pose with its evidence, and with that of the pose shifted where the surfaces hardly resist it.

    far_slips: shifted both ways by the slip along every weak direction, or the weakest; near_slips: by half of it along
    weak ones only. Each is a pose and what decides on it.
    """

    T_target_source: Array
    evidence: SightViewEvidence
    contact: SurfaceContact
    far_slips: list[tuple[Array, SightViewEvidence]]
    near_slips: list[tuple[Array, SightViewEvidence]]


def _judge(pair: Pair, settled: Settled, others: list[SightViewEvidence]) -> RegistrationResult:
    """Decide on a settled pose; an acceptance stands only if no different pose is about as good."""
    far, near = ([evidence for _, evidence in slips] for slips in (settled.far_slips, settled.near_slips))
    decided = decision.decide(settled.evidence, pair.config.decision)
    if decided.verdict is Verdict.ACCEPTED:
        others = [*others, *look_at_half_turns(pair, settled.T_target_source, settled.evidence, settled.contact)]
    decided = decision.doubt(decided, settled.evidence, decision.Doubts(others, far, near), pair.config.decision)
    return pair.answer(settled.T_target_source, settled.evidence, decided, settled.contact)


def look_at_half_turns(
    pair: Pair, T: Array, evidence: SightViewEvidence, contact: SurfaceContact
) -> list[SightViewEvidence]:
    """What decides on a pose turned by half a circle about the middle of its agreeing surface, and refined.

    About each of the main axes: in a hall, a staircase, an office the walls agree with themselves, turned. None is
    looked at where next to nothing is denied.
    """
    if evidence.denied_ratio <= _NOTHING_MUCH:
        return []
    view, limits = pair.config.sight_view, pair.config.shortlist
    with pair.watch.stage("half_turns"):
        nearest = place(pair.target, pair.source, T, view).nearest
        middle = pair.target.points[nearest[nearest >= 0]].mean(0)
        turns = (half_turn(axis, middle) @ T for axis in contact.axes())

        def look(start: Array) -> SightViewEvidence:
            refined = icp.refine_roughly(start, pair.source, pair.target, pair.config)
            refined = icp.refine_by_icp(refined, pair.source, pair.target, pair.config, limits.icp_points)
            return glance(pair.source, pair.target, refined, view)

        icp.index(pair.target, pair.config)
        return on_all_processors(look, turns)


def _settle(pair: Pair, T: Array) -> Settled:
    """Refine with more points; where a slip along a weak direction looks better, refine from there instead."""
    num_points = pair.config.shortlist.icp_last_points
    T = pair.refine(T, num_points)
    settled = _with_slips(pair, T, *pair.look_and_touch(T))
    slip, evidence = max(settled.far_slips + settled.near_slips, key=lambda item: decision.score(item[1]))
    if decision.score(evidence) <= decision.score(settled.evidence):
        return settled
    other = pair.refine(slip, num_points)
    seen, contact = pair.look_and_touch(other)
    better = decision.score(seen) > decision.score(settled.evidence)
    return _with_slips(pair, other, seen, contact) if better else settled


def _with_slips(pair: Pair, T: Array, evidence: SightViewEvidence, contact: SurfaceContact) -> Settled:
    config = pair.config.decision
    far, near = (
        [shift(T, direction, sign * distance_m) for direction in directions for sign in (-1.0, 1.0)]
        for directions, distance_m in (
            (contact.weak_directions(config.weak_constraint), config.slip_m),
            (contact.weak_directions(config.weak_constraint, at_least=0), 0.5 * config.slip_m),
        )
    )
    slips = list(zip(far + near, pair.glance_at_slips(far + near, evidence), strict=True))
    return Settled(T, evidence, contact, slips[: len(far)], slips[len(far) :])
