"""What the default method is held against: the best hypothesis as it is, and the published rule to the letter.

`sc2`: the best hypothesis by inliers, always accepted. `svc_paper`: the published algorithms.
"""

from __future__ import annotations

import dataclasses

from svc_ros.core import decision
from svc_ros.core.matches.matcher import Matcher
from svc_ros.core.pair import Pair
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Array, Correspondences
from svc_ros.core.search import shortlist
from svc_ros.core.search.hypotheses import generate_hypotheses
from svc_ros.core.sight import paper_rule


def choose_sc2(pair: Pair, matcher: Matcher) -> RegistrationResult:
    """The first hypothesis, refined on the correspondences; accepted whatever it is."""
    config, matches = pair.config, matcher.all()
    hypotheses = pair.hypotheses(matches, generate_hypotheses)
    if len(hypotheses) == 0:
        return pair.unanswered(matches)
    correspondences = Correspondences.of_all(matches)
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


def choose_paper(pair: Pair, matcher: Matcher) -> RegistrationResult:
    """Algorithm 1: the first hypothesis that passes both ways; when none passes, the first one, rejected."""
    matches = matcher.all()
    hypotheses = pair.hypotheses(matches, generate_hypotheses)
    if len(hypotheses) == 0:
        return pair.unanswered(matches)
    poses = hypotheses.T_target_source[: pair.config.paper.max_hypotheses]
    with pair.watch.stage("sight_view"):
        for tried, T in enumerate(poses, 1):
            pair.counts["judged"] = tried
            if paper_rule.check_both_ways(pair.source, pair.target, T, pair.config.paper)[2]:
                return verify_paper(pair, T)
    return verify_paper(pair, poses[0])


def verify_paper(pair: Pair, T: Array) -> RegistrationResult:
    """Algorithm 2 both ways, with what the default mode sees as further evidence."""
    in_target, in_source, passed = paper_rule.check_both_ways(pair.source, pair.target, T, pair.config.paper)
    evidence = dataclasses.replace(pair.look(T), source_in_target=in_target, target_in_source=in_source)
    blocked = max(in_target.blocked_ratio, in_source.blocked_ratio)
    verdict, reason = (Verdict.ACCEPTED, Reason.OK) if passed else (Verdict.REJECTED, Reason.SIGHT_VIEW_BLOCKED)
    detail = f"blocked share {blocked:.3f}, the paper allows {pair.config.paper.max_blocked_ratio:g}"
    return pair.answer(T, evidence, decision.Decision(verdict, reason, 1.0 - blocked, detail))
