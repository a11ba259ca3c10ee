"""Decision rules that are compared: each gives every pose a score and an answer."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize

from lib.evidence import NO_SIGHT_LINES, OPEN, Numbers, Row, evidence_of
from lib.sensors import sensor_of
from svc_ros.core import decision
from svc_ros.core.config import Config, DecisionConfig
from svc_ros.core.result import Verdict
from svc_ros.core.scan import Array
from svc_ros.core.sight.evidence import SightViewEvidence

MOVED_AWAY = 0.01  # probability of a pose that refinement did not leave where it was; as in core/decision.py
Answer = tuple[bool, float]  # accepted, score
Configs = Mapping[str, Config]


@dataclass(frozen=True)
class Variant:
    """svc with something taken away: another view of the pose, other borders, plain overlap, no doubts."""

    view: str = "refined"
    borders: Mapping[str, Any] = field(default_factory=dict)
    plain_overlap: bool = False
    slips: bool = True
    turns: bool = True


SVC = "svc"
VARIANTS: dict[str, Variant] = {
    SVC: Variant(),
    "svc, not refined": Variant(view="given"),
    "svc, nothing denied": Variant(borders=NO_SIGHT_LINES),
    "svc, plain overlap": Variant(plain_overlap=True),
    "svc, opposed surfaces allowed": Variant(borders={"max_opposed_per_overlap": OPEN}),
    "svc, one plane is enough": Variant(borders={"min_constraint": 1e-4}),
    "svc, no doubt by slips": Variant(slips=False),
    "svc, no doubt by half turns": Variant(turns=False),
}


def is_moved(row: Row, config: Config) -> bool:
    """Whether refinement took the pose farther than a right one may go."""
    limits = config.shortlist
    return row.moved[0] > limits.max_moved_rotation_deg or row.moved[1] > limits.max_moved_translation_m


def answer_variant(row: Row, config: Config, variant: Variant) -> Answer:
    """What svc answers with that taken away; the score is its probability."""
    if variant.view != "given" and is_moved(row, config):
        return False, MOVED_AWAY
    borders = dataclasses.replace(config.decision, **variant.borders)

    def evidence(numbers: Numbers) -> SightViewEvidence:
        found = evidence_of(numbers)
        agreeing = found.overlap_ratio if variant.plain_overlap else found.oriented_overlap_ratio
        return dataclasses.replace(found, oriented_overlap_ratio=agreeing)

    seen = evidence(row.seen[variant.view])
    decided = decision.decide(seen, borders)
    if decided.verdict is Verdict.ACCEPTED:
        slips = [evidence(numbers) for numbers in row.slips[variant.view] if variant.slips]
        turns = [evidence(numbers) for numbers in row.turns[variant.view] if variant.turns]
        doubts = decision.Doubts(turns, slips[0::4] + slips[3::4], slips[1::4] + slips[2::4])
        decided = decision.doubt(decided, seen, doubts, borders)
    return decided.verdict is Verdict.ACCEPTED, decided.probability


def answer_paper(row: Row) -> Answer:
    """The published rule on the pose as it was given."""
    return row.paper_passed, 1.0 - row.paper_blocked


def answer_overlap(row: Row) -> Answer:
    """Overlap of at least 0.3, on the pose as it was given."""
    overlap = row.seen["given"]["overlap_ratio"]
    return overlap >= 0.3, overlap


def smallest_margin(row: Row, config: Config, borders: Mapping[str, Any]) -> float:
    """The log margin that decides, without doubts; far below all others where refinement moved the pose away."""
    if is_moved(row, config):
        return -99.0
    return decision.measure_margins(evidence_of(row.seen["refined"]), _with(config.decision, borders)).smallest


def _with(config: DecisionConfig, borders: Mapping[str, Any]) -> DecisionConfig:
    return dataclasses.replace(config, **borders)


# --- logistic regression over few numbers -----------------------------------------------------------------------------


def features_without_sight_lines(row: Row) -> list[float]:
    """Overlap, oriented overlap and opposed surfaces of the refined pose."""
    n = row.seen["refined"]
    return [n["overlap_ratio"], n["oriented_overlap_ratio"], n["opposed_ratio"]]


def features_with_sight_lines(row: Row) -> list[float]:
    """The same and the blocked share, as the logarithm of its share of the oriented overlap."""
    n = row.seen["refined"]
    blocked = max(n[f"blocked_ratio_{way}"] for way in ("source_in_target", "target_in_source"))
    per_overlap = (blocked + 1e-3) / max(n["oriented_overlap_ratio"], 1e-3)
    return [*features_without_sight_lines(row), float(np.log(per_overlap))]


def answer_denied_share(row: Row, config: Config) -> Answer:
    """The denied share alone: below 0.08 with enough oriented overlap, facing more than one way."""
    n = row.seen["refined"]
    enough = n["oriented_overlap_ratio"] > 0.08 and n["constraint_ratio"] > 0.01
    accepted = enough and not is_moved(row, config) and n["denied_ratio"] < 0.08
    return accepted, 1.0 - n["denied_ratio"] if enough and not is_moved(row, config) else 0.0


@dataclass(frozen=True, eq=False)
class LogisticModel:
    """Log odds: offset + features (N, D) @ weights (D,)."""

    offset: float
    weights: Array

    def __call__(self, features: Array) -> Array:
        """Probability (N,) of features (N, D)."""
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(self.offset + features @ self.weights, -50, 50))))


def fit_logistic(
    features: Array, correct: Array, counted: Array | None = None, never_negative: bool = False
) -> LogisticModel:
    """Fit to features (N, D); both classes weigh the same, a weak ridge keeps separable data finite.

    counted: (N,) how much each row weighs within its class, all the same if None; never_negative: no weight is.
    """
    share = np.ones(len(features)) if counted is None else counted
    mean = np.average(features, axis=0, weights=share)
    spread = np.maximum(np.sqrt(np.average(np.square(features - mean), axis=0, weights=share)), 1e-9)
    weights = 0.5 * share / np.maximum(np.where(correct, share[correct].sum(), share[~correct].sum()), 1e-9)
    sign = np.where(correct, 1.0, -1.0)
    X = np.hstack((np.ones((len(features), 1)), (features - mean) / spread))

    def loss(w: Array) -> tuple[float, Array]:
        margin = sign * (X @ w)
        wrongness = 1.0 / (1.0 + np.exp(np.clip(margin, -50, 50)))
        ridge = 1e-3 * np.append(0.0, w[1:])
        value = float(weights @ np.logaddexp(0.0, -margin) + 0.5 * ridge @ w)
        return value, -(X * (weights * sign * wrongness)[:, None]).sum(0) + ridge

    least = [None, *([0.0 if never_negative else None] * features.shape[1])]
    w = minimize(loss, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B", bounds=[(low, None) for low in least]).x
    return LogisticModel(float(w[0] - w[1:] @ (mean / spread)), w[1:] / spread)


def answer_logistic(rows: Sequence[Row], configs: Configs, describe: Callable[[Row], list[float]]) -> list[Answer]:
    """Each sensor's poses by the model fitted on all other sensors; poses that refinement moves away are refused."""
    features, correct = np.array([describe(row) for row in rows]), np.array([row.correct for row in rows])
    names = np.array([sensor_of(row.dataset) for row in rows])
    moved = np.array([is_moved(r, configs[r.dataset]) for r in rows])
    probability = np.full(len(rows), MOVED_AWAY)
    for name in np.unique(names):
        model = fit_logistic(features[(names != name) & ~moved], correct[(names != name) & ~moved])
        tested = (names == name) & ~moved
        probability[tested] = model(features[tested])
    return [(p >= 0.5, float(p)) for p in probability]
