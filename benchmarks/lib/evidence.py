"""Everything that is measured of one labelled pose, once; every decision rule then works on these numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lib.common import config_of
from svc_ros.core import decision, selection
from svc_ros.core.config import Config, DecisionConfig
from svc_ros.core.pair import Pair
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import Verdict
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.se3 import invert, pose_error
from svc_ros.core.sight import paper_rule
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.core.sight.observability import shift
from svc_ros.core.sight.sight_view import gather_evidence, glance
from svc_ros.core.stopwatch import Stopwatch
from svc_ros.io.datasets import Candidate, CandidatePair, Dataset

Numbers = Mapping[str, float]

VIEWS = ("refined", "given")  # the pose as `verify` refines it, and as it was given
_EVERY = 10  # one pose in so many is also given to `verify` itself
OPEN = 10.0  # a border that nothing reaches
NO_SIGHT_LINES: Mapping[str, Any] = {
    "offset": 100.0, "denied_weight": 0.0, "wide_denied_weight": 0.0, "structure_weight": 0.0,
    "max_free_blocked_per_overlap": OPEN,
}  # fmt: skip


@dataclass(frozen=True)
class Contact:
    """Information (6, 6), residual variance and error (6,) [m, rad] of a refined pose against the reference."""

    information: Array
    variance: float
    error: Array


@dataclass(frozen=True)
class Row:
    """One labelled pose. seen: evidence of each view; slips: evidence of the shifted poses of a view, in the order of
    `slipped`, and turns: of its half turns, where any rule might accept it; contact: of right poses only; verified:
    verdict and probability that `verify` gave, for a sample of poses."""

    dataset: str
    pair: str
    origin: str
    correct: bool
    moved: tuple[float, float]
    seen: Mapping[str, Numbers]
    slips: Mapping[str, Sequence[Numbers]]
    turns: Mapping[str, Sequence[Numbers]]
    paper_blocked: float
    paper_passed: bool
    contact: Contact | None = None
    verified: tuple[str, float] | None = field(default=None)


def evidence_of(numbers: Numbers) -> SightViewEvidence:
    """Evidence with these numbers; which lines are blocked and which points denied is not known any more."""
    shares = {f.name: numbers[f.name] for f in dataclasses.fields(SightViewEvidence) if f.name in numbers}
    ways = ("source_in_target", "target_in_source")
    lines, seen = ([make(numbers, way) for way in ways] for make in (_lines, _surface))
    return SightViewEvidence(*lines, **shares, source_surface=seen[0], target_surface=seen[1])


def _lines(numbers: Numbers, way: str) -> SightLines:
    num_lines, num_blocked = int(numbers[f"num_lines_{way}"]), int(numbers[f"num_blocked_{way}"])
    names, observed = np.zeros(num_blocked, np.int64), round(numbers[f"observed_ratio_{way}"] * num_lines)
    free = (int(numbers[f"{name}_{way}"]) for name in ("num_free", "num_free_blocked"))
    return SightLines(num_lines, observed, names, names, *free)


def _surface(numbers: Numbers, way: str) -> SeenSurface:
    names = ("num_points", "num_confirmed", "num_hidden", "num_unseen")
    counts = {name: int(numbers[f"{name}_{way}"]) for name in names}
    denied = np.zeros(int(numbers[f"num_denied_{way}"]), np.int64)
    return SeenSurface(**counts, denied_idx=denied, wide_denied=numbers[f"wide_denied_{way}"])


@dataclass(frozen=True, eq=False)
class Judged:
    """Poses to measure between two scans (source, target); reference: the true pose (4, 4), of right poses only."""

    dataset: str
    pair: str
    scans: tuple[PreparedScan, PreparedScan]
    config: Config
    candidates: Sequence[Candidate]
    reference: Array


def gather(job: tuple[Dataset, CandidatePair, int]) -> list[Row]:
    """The rows of all labelled poses of one pair; grey ones are left out. `job` ends with the pair's number."""
    dataset, labelled, number = job
    config = config_of(dataset)
    source, target = (prepare(dataset.read_scan(path), config) for path in (labelled.source, labelled.target))
    reference = next(c.T_target_source for c in labelled.candidates if c.origin == "reference")
    name = f"{labelled.source} -> {labelled.target}"
    chosen = [c for c in labelled.candidates if c.label != "grey"]
    return measure_all(Judged(dataset.name, name, (source, target), config, chosen, reference), number)


def measure_all(judged: Judged, number: int) -> list[Row]:
    """The rows of all poses of a pair; `number` spreads the sample that `verify` itself is asked about."""
    rows = []
    for k, candidate in enumerate(judged.candidates):
        row = _measure(judged.scans, judged.config, candidate, judged.reference)
        if (k + number) % _EVERY == 0:
            result = verify(*judged.scans, candidate.T_target_source, judged.config)
            row = dataclasses.replace(row, verified=(result.verdict.value, float(result.probability or 0.0)))
        rows.append(dataclasses.replace(row, dataset=judged.dataset, pair=judged.pair))
    return rows


def _measure(scans: tuple[PreparedScan, PreparedScan], config: Config, candidate: Candidate, reference: Array) -> Row:
    pair = Pair(*scans, config, {}, Stopwatch())
    given = candidate.T_target_source
    refined = pair.refine(given, config.shortlist.icp_last_points)
    seen: dict[str, Numbers] = {}
    slips: dict[str, list[Numbers]] = {}
    turns: dict[str, list[Numbers]] = {}
    for view, T in zip(VIEWS, (refined, given), strict=True):
        evidence = gather_evidence(*scans, T, config.sight_view)
        seen[view] = evidence.numbers()
        if _may_be_accepted(evidence, config.decision):
            slips[view] = [glance(*scans, slip, config.sight_view).numbers() for slip in slipped(pair, T)]
            half_turns = selection.look_at_half_turns(pair, T, evidence, pair.contact(T))
            turns[view] = [found.numbers() for found in half_turns]
    in_target, in_source, passed = paper_rule.check_both_ways(*scans, given, config.paper)
    correct = candidate.label == "correct"
    return Row(
        "", "", candidate.origin, correct, pose_error(refined, given), seen, slips, turns,
        max(in_target.blocked_ratio, in_source.blocked_ratio), passed,
        _contact(pair, refined, reference) if correct else None,
    )  # fmt: skip


def slipped(pair: Pair, T: Array) -> list[Array]:
    """The shifted poses that `verify` looks at, by weak direction: far back, back, ahead, far ahead.

    Where no direction is weak, it looks at far ones only: they stand in the place of the near ones, too.
    """
    contact, config = pair.contact(T), pair.config.decision
    directions = contact.weak_directions(config.weak_constraint)
    far, num_weak = config.slip_m, len(contact.weak_directions(config.weak_constraint, at_least=0))
    near = 0.5 * far if num_weak else far
    return [shift(T, direction, d) for direction in directions for d in (-far, -near, near, far)]


def _may_be_accepted(evidence: SightViewEvidence, config: DecisionConfig) -> bool:
    """Whether any rule that is compared might accept it: whatever is denied or opposed, on one plane alone."""
    loose = dataclasses.replace(config, **NO_SIGHT_LINES, max_opposed_per_overlap=OPEN, min_constraint=1e-4)
    plain = dataclasses.replace(evidence, oriented_overlap_ratio=evidence.overlap_ratio)
    return any(decision.decide(e, loose).verdict is Verdict.ACCEPTED for e in (evidence, plain))


def _contact(pair: Pair, T: Array, reference: Array) -> Contact:
    contact = pair.contact(T)
    return Contact(contact.information, contact.variance_m2, pose_difference(T, reference))


def pose_difference(T: Array, reference: Array) -> Array:
    """Left perturbation (6,) [m, rad] that leads from the reference to T, in the order of the covariance."""
    from scipy.spatial.transform import Rotation

    difference = T @ invert(reference)
    return np.concatenate((difference[:3, 3], Rotation.from_matrix(difference[:3, :3]).as_rotvec()))


def check_against_verify(rows: Sequence[Row], answers: Mapping[int, Any]) -> tuple[int, int]:
    """How many poses of the sample `verify` answered as the rule did that was put together here, and how many differ.

    answers: (accepted, probability) by the row's index.
    """
    same = [
        (row.verified[0] == "accepted") == answers[k][0] and abs(row.verified[1] - answers[k][1]) < 1e-3
        for k, row in enumerate(rows)
        if row.verified is not None
    ]
    return sum(same), len(same) - sum(same)
