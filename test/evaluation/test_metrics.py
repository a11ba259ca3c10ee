"""Metrics against values worked out by hand and against brute force over pairs and thresholds."""

from __future__ import annotations

import numpy as np
import pytest

from svc_ros.core.errors import InputError
from svc_ros.core.se3 import make_pose
from svc_ros.evaluation.metrics import (
    LabelledDecision,
    PairOutcome,
    decision_metrics,
    false_accepts_by_origin,
    judge_pose,
    percentile,
    recall_at_precision,
    registration_metrics,
    roc_auc,
)
from svc_ros.io.datasets import SuccessThresholds

LIMITS = SuccessThresholds(rotation_deg=5.0, translation_m=0.6)


def turn_z(degrees: float, translation: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return make_pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], translation)


def brute_force_auc(scores: np.ndarray, correct: np.ndarray) -> float:
    right, wrong = scores[correct], scores[~correct]
    wins = sum((a > b) + 0.5 * (a == b) for a in right for b in wrong)
    return wins / (len(right) * len(wrong))


def brute_force_recall(scores: np.ndarray, correct: np.ndarray, precision: float) -> float:
    best = 0.0
    for threshold in scores:
        chosen = scores >= threshold
        if (chosen & correct).sum() / chosen.sum() >= precision:
            best = max(best, (chosen & correct).sum() / correct.sum())
    return best


def test_errors_of_a_candidate_are_its_angle_and_distance():
    outcome = judge_pose(turn_z(4.0, (3.0, 4.0, 0.0)), np.eye(4), LIMITS, accepted=True)
    assert outcome.rotation_error_deg == pytest.approx(4.0)
    assert outcome.translation_error_m == pytest.approx(5.0)
    assert outcome.accepted
    assert not outcome.correct


@pytest.mark.parametrize(
    ("degrees", "metres", "right"), [(4.9, 0.59, True), (5.1, 0.1, False), (0.1, 0.61, False), (0.0, 0.6, True)]
)
def test_a_pose_is_right_only_within_both_thresholds(degrees, metres, right):
    assert judge_pose(turn_z(degrees, (metres, 0, 0)), np.eye(4), LIMITS, accepted=False).correct is right


def test_no_candidate_is_wrong_and_has_no_errors():
    outcome = judge_pose(None, np.eye(4), LIMITS, accepted=False)
    assert outcome == PairOutcome(False, False, None, None)


def test_registration_numbers_by_hand():
    outcomes = [
        PairOutcome(True, True, 1.0, 0.1),
        PairOutcome(True, True, 3.0, 0.3),
        PairOutcome(True, False, 90.0, 9.0),
        PairOutcome(False, True, 2.0, 0.2),
        PairOutcome(False, False),
    ]
    assert registration_metrics(outcomes) == {
        "num_pairs": 5,
        "num_accepted": 3,
        "num_correct_accepted": 2,
        "num_false_accepted": 1,
        "success_rate": 0.4,
        "candidate_success_rate": 0.6,
        "rotation_error_deg_mean": 2.0,
        "translation_error_m_mean": pytest.approx(0.2),
    }


def test_registration_numbers_of_nothing_are_none_and_not_nan():
    numbers = registration_metrics([])
    assert numbers["num_pairs"] == 0
    assert numbers["success_rate"] is None
    assert numbers["rotation_error_deg_mean"] is None


def decisions(*rows: tuple[bool, bool, float | None]) -> list[LabelledDecision]:
    return [LabelledDecision(accepted, correct, p) for accepted, correct, p in rows]


def test_decision_numbers_by_hand():
    numbers = decision_metrics(
        decisions((True, True, 0.9), (True, True, 0.8), (False, True, 0.3), (True, False, 0.7), (False, False, 0.1))
    )
    assert numbers["num_correct"] == 3
    assert numbers["num_wrong"] == 2
    assert numbers["precision"] == pytest.approx(2 / 3)
    assert numbers["recall"] == pytest.approx(2 / 3)
    assert numbers["f1"] == pytest.approx(2 / 3)
    assert numbers["roc_auc"] == pytest.approx(5 / 6)  # of 3 x 2 comparisons only 0.3 against 0.7 is lost
    assert numbers["recall_at_precision_99"] == pytest.approx(2 / 3)


def test_f1_is_the_harmonic_mean():
    numbers = decision_metrics(decisions((True, True, 0.9), (True, False, 0.8), (True, False, 0.7), (False, True, 0.1)))
    p, r = numbers["precision"], numbers["recall"]
    assert (p, r) == (pytest.approx(1 / 3), pytest.approx(1 / 2))
    assert numbers["f1"] == pytest.approx(2 * p * r / (p + r))


def test_nothing_accepted_has_no_precision_but_a_recall_of_zero():
    numbers = decision_metrics(decisions((False, True, 0.2), (False, False, 0.1)))
    assert numbers["precision"] is None
    assert numbers["recall"] == 0.0
    assert numbers["f1"] == 0.0


def test_a_pose_that_was_not_judged_ranks_last():
    assert decision_metrics(decisions((False, True, 0.0), (False, False, None)))["roc_auc"] == 1.0


def test_a_method_without_probability_has_no_ranking_numbers():
    numbers = decision_metrics(decisions((True, True, None), (True, False, None)))
    assert numbers["roc_auc"] is None
    assert numbers["recall_at_precision_99"] is None
    assert numbers["precision"] == 0.5


def test_roc_auc_is_none_with_one_class_and_half_with_one_score():
    assert roc_auc([0.1, 0.9], [True, True]) is None
    assert roc_auc([0.1, 0.9], [False, False]) is None
    assert roc_auc([0.5] * 7, [True, False, False, True, False, False, False]) == 0.5


def test_recall_at_precision_takes_ties_together():
    # the threshold 0.9 accepts one right and one wrong pose at once: no threshold is precise
    assert recall_at_precision([0.9, 0.9, 0.1], [True, False, True], 0.99) == 0.0
    assert recall_at_precision([0.9, 0.8, 0.8], [True, False, True], 0.99) == 0.5
    assert recall_at_precision([0.9], [True], 0.99) is None


@pytest.mark.parametrize("num_levels", [3, 10, 1000])
def test_ranking_numbers_equal_brute_force(num_levels):
    rng = np.random.default_rng(num_levels)
    for _ in range(20):
        correct = rng.random(60) < 0.5
        scores = np.round((rng.random(60) + correct) / 2 * num_levels) / num_levels
        assert roc_auc(scores, correct) == pytest.approx(brute_force_auc(scores, correct), abs=1e-12)
        for precision in (0.7, 0.9, 0.99):
            expected = brute_force_recall(scores, correct, precision)
            assert recall_at_precision(scores, correct, precision) == pytest.approx(expected, abs=1e-12)


def test_scores_that_cannot_be_ranked_are_refused():
    with pytest.raises(InputError, match="NaN"):
        roc_auc([np.nan, 0.1], [True, False])
    with pytest.raises(InputError, match="one length"):
        roc_auc([0.1], [True, False])


def test_false_accepts_are_counted_by_origin():
    rows = [
        LabelledDecision(True, False, 0.9, "yaw180"),
        LabelledDecision(True, False, 0.9, "yaw180"),
        LabelledDecision(False, False, 0.1, "far"),
        LabelledDecision(True, True, 0.9, "reference"),
    ]
    assert false_accepts_by_origin(rows) == {"far": 0, "yaw180": 2}


def test_percentiles_interpolate_and_are_none_without_values():
    assert percentile([1.0, 2.0, 3.0, 4.0], 50) == 2.5
    assert percentile([], 50) is None
