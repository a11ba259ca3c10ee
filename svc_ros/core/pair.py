"""Two prepared scans on their way to a verdict: the looks that every method takes at a pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from svc_ros.core import decision
from svc_ros.core.config import Config
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import NO_HYPOTHESES, Array, Correspondences, HypothesisSet, PreparedScan
from svc_ros.core.scans.levelling import Level, find_level
from svc_ros.core.scans.oddities import explain_pair
from svc_ros.core.search import icp
from svc_ros.core.search.hypotheses import Generator, generate_from_each
from svc_ros.core.search.prescore import thinned_scan
from svc_ros.core.sight.evidence import SightViewEvidence
from svc_ros.core.sight.observability import SurfaceContact, find_contact
from svc_ros.core.sight.placement import place
from svc_ros.core.sight.sight_view import gather_evidence, glance, index, look_both_ways
from svc_ros.core.sight.weak_directions import find_weak_directions
from svc_ros.core.stopwatch import Stopwatch

_GLIMPSE_POINTS = 1500  # of each scan, for slips


@dataclass(frozen=True, eq=False)
class Pair:
    """Two prepared scans on their way to a verdict, with what was counted and timed so far."""

    source: PreparedScan
    target: PreparedScan
    config: Config
    counts: dict[str, int]
    watch: Stopwatch

    def levels(self) -> list[Level]:
        """How either scan stands on the ground; none where one does not see it, or nobody asks for levelled poses."""
        if self.config.hypotheses.levelled_poses == 0:
            return []
        with self.watch.stage("levelled"):
            z_is_up = self.config.hypotheses.gravity_aligned
            found = on_all_processors(lambda scan: find_level(scan, z_is_up), (self.source, self.target))
        known = [level for level in found if level is not None]
        return known if len(known) == len(found) else []

    def hypotheses(self, sets: Sequence[Correspondences], generate: Generator) -> HypothesisSet:
        """Poses that many correspondences of one set agree on; none where every set has too few."""
        enough = [each for each in sets if len(each) >= self.config.matching.min_correspondences]
        with self.watch.stage("hypotheses"):
            found = generate_from_each(generate, enough, self.config.hypotheses) if enough else NO_HYPOTHESES
        self.counts.update(correspondences=sum(map(len, sets)), hypotheses=len(found))
        return found

    def look(self, T: Array) -> SightViewEvidence:
        """The evidence of one pose."""
        with self.watch.stage("sight_view"):
            return gather_evidence(self.source, self.target, T, self.config.sight_view)

    def look_and_touch(self, T: Array) -> tuple[SightViewEvidence, SurfaceContact]:
        """The evidence of one pose, and the agreeing surface under it."""
        view = self.config.sight_view
        with self.watch.stage("sight_view"):
            evidence, in_target = look_both_ways(self.source, self.target, T, view)
        with self.watch.stage("observability"):
            return evidence, find_contact(self.target, in_target, view)

    def glance_at_all(self, poses: Sequence[Array]) -> list[SightViewEvidence]:
        """What decides on each pose, on all processors; blocked lines are not looked for."""
        view = self.config.sight_view
        with self.watch.stage("sight_view"):
            index((self.source, self.target), view)
            return on_all_processors(lambda T: glance(self.source, self.target, T, view), poses)

    def glance_at_slips(self, slips: Sequence[Array], evidence: SightViewEvidence) -> list[SightViewEvidence]:
        """The same of slips of a pose with that evidence; with few points where they tell enough against a slip."""
        view, decides = self.config.sight_view, self.config.decision

        def look(T: Array) -> SightViewEvidence:
            few = glance(self.source, self.target, T, view, _GLIMPSE_POINTS)
            hopeless = decision.is_far_worse(few, evidence, decides)
            return few if hopeless else glance(self.source, self.target, T, view)

        with self.watch.stage("sight_view"):
            for scan in (self.source, self.target):
                thinned_scan(scan, _GLIMPSE_POINTS)
            index((self.source, self.target), view)
            return on_all_processors(look, slips)

    def promise(self, evidence: SightViewEvidence) -> float:
        """What poses are ranked by: the smallest margin that the decision will look at."""
        return decision.measure_margins(evidence, self.config.decision).smallest

    def refine(self, T: Array, num_points: int) -> Array:
        """One pose after ICP with about that many points."""
        with self.watch.stage("refinement"):
            return icp.refine_by_icp(T, self.source, self.target, self.config, num_points)

    def contact(self, T: Array) -> SurfaceContact:
        """The agreeing surface under one pose."""
        view = self.config.sight_view
        with self.watch.stage("observability"):
            return find_contact(self.target, place(self.target, self.source, T, view), view)

    def unanswered(self, sets: Sequence[Correspondences]) -> RegistrationResult:
        """The result where these correspondences led to no pose."""
        most, least = max(map(len, sets)), self.config.matching.min_correspondences
        if most < least:
            reason = Reason.TOO_FEW_CORRESPONDENCES
            detail = f"{most} correspondences, at least {least} are needed"
        else:
            reason, detail = Reason.NO_HYPOTHESIS, "no consistent set of correspondences"
        return RegistrationResult(
            Verdict.REJECTED, reason, self.config.method, probability=0.0, counts=self.counts,
            time_ms=self.watch.times(), detail=self._with_oddities(detail),
        )  # fmt: skip

    def answer(
        self,
        T: Array,
        evidence: SightViewEvidence | None,
        decided: decision.Decision,
        contact: SurfaceContact | None = None,
    ) -> RegistrationResult:
        """The result for the pose T; it is the transform exactly if the verdict is ACCEPTED."""
        accepted = decided.verdict is Verdict.ACCEPTED
        contact = self.contact(T) if contact is None else contact
        covariance = contact.covariance(self.config.covariance) if accepted else None
        detail = decided.detail if accepted else self._with_oddities(decided.detail)
        weak = find_weak_directions(contact, self.config.decision.weak_constraint)
        return RegistrationResult(
            decided.verdict, decided.reason, self.config.method, T if accepted else None, T,
            covariance, decided.probability, evidence, self.counts, self.watch.times(), detail, weak,
        )  # fmt: skip

    def _with_oddities(self, detail: str) -> str:
        """Why a pair was not accepted, with what is odd about its scans: it may be the cause."""
        odd = explain_pair(self.source, self.target)
        return f"{detail}; {odd}" if odd else detail
