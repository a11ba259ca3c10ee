"""How each method chooses one pose and judges it.

`sc2`: the best hypothesis by inliers, always accepted. `svc_paper`: the published algorithms to the letter. `svc`:
the default, every distinct hypothesis refined, looked at along the sight lines of both scans, the best one judged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from svc_ros.core import decision, icp, paper_rule, shortlist
from svc_ros.core.evidence import SightViewEvidence
from svc_ros.core.observability import SurfaceContact, shift
from svc_ros.core.pair import Pair
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.placement import place
from svc_ros.core.prescore import thinned_scan
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, Correspondences, HypothesisSet
from svc_ros.core.se3 import half_turn, pose_error
from svc_ros.core.sight_view import glance, index

_NOTHING_MUCH = 0.025  # denied share up to which an accepted pose is not held against its half turns
_HOPELESS = float(np.log(8.0))  # a pose that promises less by this can neither win nor cast doubt on the winner


def choose_sc2(pair: Pair, correspondences: Correspondences, hypotheses: HypothesisSet) -> RegistrationResult:
    """The first hypothesis, refined on the correspondences; accepted whatever it is."""
    config = pair.config
    with pair.watch.stage("refinement"):
        T = shortlist.refine_on_correspondences(
            hypotheses.T_target_source[0], correspondences, config.hypotheses, config.shortlist
        )
    share = float(hypotheses.num_inliers[0]) / len(correspondences)
    return pair.answer(T, pair.look(T), _accept_blindly(share))


def verify_sc2(pair: Pair, T: Array) -> RegistrationResult:
    """No judgement: every pose is accepted."""
    evidence = pair.look(T)
    return pair.answer(T, evidence, _accept_blindly(evidence.overlap_ratio))


def _accept_blindly(probability: float) -> decision.Decision:
    return decision.Decision(Verdict.ACCEPTED, Reason.OK, probability, "method sc2 accepts without judging")


def choose_paper(pair: Pair, correspondences: Correspondences, hypotheses: HypothesisSet) -> RegistrationResult:
    """Algorithm 1: the first hypothesis that passes both ways; when none passes, the first one, rejected."""
    poses = hypotheses.T_target_source[: pair.config.paper.max_hypotheses]
    with pair.watch.stage("sight_view"):
        for tried, T in enumerate(poses, 1):
            pair.counts["judged"] = tried
            if paper_rule.check_both_ways(pair.source, pair.target, T, pair.config.paper)[2]:
                return _paper_answer(pair, T)
    return _paper_answer(pair, poses[0])


def _paper_answer(pair: Pair, T: Array) -> RegistrationResult:
    """Algorithm 2 both ways, with what the default mode sees as further evidence."""
    in_target, in_source, passed = paper_rule.check_both_ways(pair.source, pair.target, T, pair.config.paper)
    evidence = dataclasses.replace(pair.look(T), source_in_target=in_target, target_in_source=in_source)
    blocked = max(in_target.blocked_ratio, in_source.blocked_ratio)
    verdict, reason = (Verdict.ACCEPTED, Reason.OK) if passed else (Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
    detail = f"blocked share {blocked:.3f}, the paper allows {pair.config.paper.max_blocked_ratio:g}"
    return pair.answer(T, evidence, decision.Decision(verdict, reason, 1.0 - blocked, detail))


def choose_svc(pair: Pair, correspondences: Correspondences, hypotheses: HypothesisSet) -> RegistrationResult:
    """Judge the pose that looks best along the sight lines; if it is not accepted, look much wider and judge again."""
    config = pair.config
    with pair.watch.stage("shortlist"):
        by_agreement = shortlist.order_by_agreement(hypotheses.T_target_source, pair.source, pair.target, config)
        starts = shortlist.shortlist(hypotheses, correspondences, by_agreement, config)
        poses, promise = _look_roughly(pair, starts)
    result = _choose_best(pair, poses[promise > promise[0] - _HOPELESS])
    if result.accepted or config.shortlist.rough_poses == 0:
        return result
    return _choose_best(pair, np.concatenate((_search_widely(pair, by_agreement), starts[:1])))


def _look_roughly(pair: Pair, starts: Array) -> tuple[Array, Array]:
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


def _choose_best(pair: Pair, starts: Array) -> RegistrationResult:
    """Refine poses (S, 4, 4), look along the sight lines of each, judge the best; the others may cast doubt on it."""
    limits = pair.config.shortlist
    refined = np.array([pair.refine(T, limits.icp_points) for T in starts])
    pair.counts["judged"] = pair.counts.get("judged", 0) + len(refined)
    evidence = pair.glance_at_all(list(refined))
    settled = _settle(pair, refined[int(np.argmax([pair.promise(e) for e in evidence]))])
    near = shortlist.find_near(refined, settled.T_target_source, limits)
    return _judge(pair, settled, [e for e, same in zip(evidence, near, strict=True) if not same])


def _search_widely(pair: Pair, by_agreement: Array) -> Array:
    """The best of many hypotheses (H, 4, 4), each refined and looked at roughly, with few points of both scans.

    At low overlap a right pose has hardly more inliers or overlap than wrong ones; its free sight lines tell it.
    """
    limits = pair.config.shortlist
    with pair.watch.stage("wide_search"):
        starts = by_agreement[shortlist.select_distinct(by_agreement, limits, limits.rough_poses)]
        T, _ = _look_roughly(pair, starts)
        pair.counts["searched"] = len(T)
        return np.asarray(T[shortlist.select_distinct(T, limits, limits.max_poses)])


def verify_svc(pair: Pair, T: Array) -> RegistrationResult:
    """Refine the pose and judge it; one that refinement moves away is not the pose that was asked about."""
    refined = pair.refine(T, pair.config.shortlist.icp_last_points)
    angle, distance = pose_error(refined, T)
    limits = pair.config.shortlist
    if angle > limits.max_moved_rotation_deg or distance > limits.max_moved_translation_m:
        return pair.answer(T, pair.look(T), decision.moved_away(angle, distance))
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


Chooser = Callable[[Pair, Correspondences, HypothesisSet], RegistrationResult]
METHODS: dict[str, Chooser] = {"sc2": choose_sc2, "svc_paper": choose_paper, "svc": choose_svc}
VERIFIERS: dict[str, Callable[[Pair, Array], RegistrationResult]] = {
    "sc2": verify_sc2,
    "svc_paper": _paper_answer,
    "svc": verify_svc,
}
