"""Numbers that summarise many decisions. Plain numpy; a number that is not defined is None, never NaN."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import pose_error
from svc_ros.io.datasets import SuccessThresholds

Number = float | int | None

_PRECISION_GOAL = 0.99


@dataclass(frozen=True)
class PairOutcome:
    """One registered pair against its reference.

    accepted: the verdict; rotation_error_deg, translation_error_m: of the best candidate (None without one);
    correct: whether that candidate is within the data set's thresholds.
    """

    accepted: bool
    correct: bool
    rotation_error_deg: float | None = None
    translation_error_m: float | None = None


@dataclass(frozen=True)
class LabelledDecision:
    """One pose of a decision benchmark: was it accepted, is it right, how sure was the decision (None: not judged)."""

    accepted: bool
    correct: bool
    probability: float | None
    origin: str = ""


def judge_pose(
    T_estimate: ArrayLike | None, T_reference: ArrayLike, success: SuccessThresholds, accepted: bool
) -> PairOutcome:
    """Compare the best candidate (4, 4) of a pair, or None, with the reference pose (4, 4)."""
    if T_estimate is None:
        return PairOutcome(accepted, False)
    rotation, translation = pose_error(T_estimate, T_reference)
    correct = rotation <= success.rotation_deg and translation <= success.translation_m
    return PairOutcome(accepted, correct, rotation, translation)


def registration_metrics(outcomes: Sequence[PairOutcome]) -> dict[str, Number]:
    """Summarise registered pairs.

    success_rate: accepted and right, over all pairs; candidate_success_rate: best candidate right, whatever the
    verdict (the papers' registration recall); the mean errors are taken over the successes (accepted and right).
    """
    successes = [o for o in outcomes if o.accepted and o.correct]
    num_accepted = sum(o.accepted for o in outcomes)
    return {
        "num_pairs": len(outcomes),
        "num_accepted": num_accepted,
        "num_correct_accepted": len(successes),
        "num_false_accepted": num_accepted - len(successes),
        "success_rate": _ratio(len(successes), len(outcomes)),
        "candidate_success_rate": _ratio(sum(o.correct for o in outcomes), len(outcomes)),
        "rotation_error_deg_mean": _mean(o.rotation_error_deg for o in successes),
        "translation_error_m_mean": _mean(o.translation_error_m for o in successes),
    }


def decision_metrics(decisions: Sequence[LabelledDecision]) -> dict[str, Number]:
    """Summarise a decision benchmark; positive means accepted. Grey candidates must be left out by the caller.

    roc_auc and recall_at_precision_99 rank by the probability; a pose that was not judged ranks below all that were.
    They are None where a class is absent or where the method gives no probability at all.
    """
    correct = np.array([d.correct for d in decisions], bool)
    accepted = np.array([d.accepted for d in decisions], bool)
    true_accepted, num_accepted = int((accepted & correct).sum()), int(accepted.sum())
    num_correct = int(correct.sum())
    num_wrong = len(decisions) - num_correct
    scores = np.array([-1.0 if d.probability is None else d.probability for d in decisions])
    scored = any(d.probability is not None for d in decisions)
    return {
        "num_correct": num_correct,
        "num_wrong": num_wrong,
        "precision": _ratio(true_accepted, num_accepted),
        "recall": _ratio(true_accepted, num_correct),
        "f1": _ratio(2 * true_accepted, num_accepted + num_correct),
        "roc_auc": roc_auc(scores, correct) if scored else None,
        "recall_at_precision_99": recall_at_precision(scores, correct, _PRECISION_GOAL) if scored else None,
    }


def false_accepts_by_origin(decisions: Iterable[LabelledDecision]) -> dict[str, int]:
    """Count accepted wrong poses by where they came from; every origin with wrong poses is named, 0 too."""
    counts: dict[str, int] = {}
    for d in decisions:
        if not d.correct:
            counts[d.origin] = counts.get(d.origin, 0) + int(d.accepted)
    return dict(sorted(counts.items()))


def roc_auc(scores: ArrayLike, correct: ArrayLike) -> float | None:
    """Area under the ROC curve of scores (N,) for labels (N,): the chance that a right one outranks a wrong one.

    Equal scores count one half. None where one of the two classes is absent.
    """
    s, y = _scores_and_labels(scores, correct)
    num_correct, num_wrong = int(y.sum()), int((~y).sum())
    if not num_correct or not num_wrong:
        return None
    _, group, sizes = np.unique(s, return_inverse=True, return_counts=True)
    mean_rank = np.cumsum(sizes) - 0.5 * (sizes - 1)  # ranks from 1; a group of ties shares its mean
    rank_sum = float(mean_rank[group][y].sum())
    return (rank_sum - 0.5 * num_correct * (num_correct + 1)) / (num_correct * num_wrong)


def recall_at_precision(scores: ArrayLike, correct: ArrayLike, precision: float) -> float | None:
    """Largest recall of any score threshold whose precision is at least `precision`; 0 where no threshold reaches it.

    Equal scores are accepted or refused together. None where one of the two classes is absent.
    """
    s, y = _scores_and_labels(scores, correct)
    if not y.any() or y.all():
        return None
    order = np.argsort(-s, kind="stable")
    last_of_group = np.append(np.diff(s[order]) != 0, True)
    hits = np.cumsum(y[order])[last_of_group]
    accepted = np.flatnonzero(last_of_group) + 1
    good = hits >= precision * accepted
    return float(hits[good].max() / y.sum()) if good.any() else 0.0


def percentile(values: Iterable[float], q: float) -> float | None:
    """The q-th percentile, q in [0, 100], linear between neighbours; None without values."""
    found = np.fromiter(values, np.float64)
    return float(np.percentile(found, q)) if len(found) else None


def _scores_and_labels(scores: ArrayLike, correct: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    s, y = np.asarray(scores, np.float64), np.asarray(correct, bool)
    if s.ndim != 1 or s.shape != y.shape:
        raise InputError(f"scores and labels: expected two lists of one length, found {s.shape} and {y.shape}")
    if np.isnan(s).any():
        raise InputError("scores: expected numbers, found NaN")
    return s, y


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _mean(values: Iterable[float | None]) -> float | None:
    found = [v for v in values if v is not None]
    return float(np.mean(found)) if found else None
