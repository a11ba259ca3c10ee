"""Both definitions of recall, the RMSE through the information matrix, and means over pairs and over scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import suite_folders as folders
from mini_data import scan_room

from svc_ros.core import se3
from svc_ros.core.scan import Array
from svc_ros.evaluation.suite_recall import information_rmse, is_right, summarise_recall
from svc_ros.io.datasets import SuccessThresholds
from svc_ros.io.suites import Criterion, Suite, SuitePair

BY_ERRORS = Criterion("errors", rotation_deg=15.0, translation_m=0.3)
BY_RMSE = Criterion("rmse", max_rmse_m=0.2, min_gap=2)


def turned(deg: float, t: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    return se3.make_pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], t)


def row(rotation: float | None, translation: float | None, rmse: float | None, verdict: str = "accepted") -> dict:
    return {"rotation_error_deg": rotation, "translation_error_m": translation, "rmse_m": rmse, "verdict": verdict}


def suite_of(*pairs: SuitePair) -> Suite:
    return Suite(
        Path(), "small", "", "rgbd_indoor", 0.0, 10.0, np.zeros(3), SuccessThresholds(15.0, 0.3), list(pairs),
        criteria=(BY_ERRORS, BY_RMSE),
    )  # fmt: skip


def pair_of(group: str, i: int, j: int) -> SuitePair:
    return SuitePair("", "", np.eye(4), group=group, indices=(i, j))


def test_the_rmse_of_a_shift_is_its_length_whatever_the_reference():
    information = folders.information_of(scan_room(folders.FRAGMENT_POSES[0])[::50])
    reference = turned(40.0, (1.0, -2.0, 0.5))
    estimate = reference @ turned(0.0, (0.03, 0.0, -0.04))
    assert information_rmse(estimate, reference, information) == pytest.approx(0.05)
    assert information_rmse(reference, reference, information) == pytest.approx(0.0, abs=1e-7)


def test_the_rmse_of_a_turn_is_by_the_quaternion_of_the_benchmark():
    """Its matrices take the quaternion's vector part, half the angle, where the points would move by all of it."""
    points = scan_room(folders.FRAGMENT_POSES[0])[::50]
    information, angle = folders.information_of(points), np.radians(6.0)
    moved = np.sqrt(np.mean(np.sum(np.square(points[:, :2]), axis=1))) * np.sin(angle / 2.0)
    assert information_rmse(turned(6.0), np.eye(4), information) == pytest.approx(moved, rel=1e-9)
    assert information_rmse(turned(-6.0), np.eye(4), information) == pytest.approx(moved, rel=1e-9)
    reference = turned(40.0, (1.0, -2.0, 0.5))  # the turn is about the source's origin, wherever the target's is
    assert information_rmse(reference @ turned(6.0), reference, information) == pytest.approx(moved, rel=1e-6)


def test_a_shift_and_a_turn_that_undo_each_other_at_the_points_have_a_small_rmse():
    """The sign of the coupling between both: with the wrong one this motion would look twice as large as either."""
    points = np.array([[4.0, 0.0, 0.0], [4.0, 0.1, 0.0], [4.0, 0.0, 0.1]])
    information = folders.information_of(points)
    q = 0.01
    turn = se3.make_pose(turned(2.0 * np.degrees(np.arcsin(q)))[:3, :3], (0.0, -4.0 * q, 0.0))
    assert information_rmse(turn, np.eye(4), information) < 0.1 * 4.0 * q


def test_half_a_turn_has_a_large_rmse_not_none():
    information = folders.information_of(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert information_rmse(turned(180.0), np.eye(4), information) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("found", "by_errors", "by_rmse"),
    [
        (row(14.9, 0.29, 0.21), True, False),
        (row(15.1, 0.1, 0.19), False, True),
        (row(1.0, 0.31, 0.2), False, True),
        (row(None, None, None), False, False),
    ],
)
def test_each_definition_has_its_own_bounds(found, by_errors, by_rmse):
    assert (is_right(BY_ERRORS, found), is_right(BY_RMSE, found)) == (by_errors, by_rmse)


def test_means_over_pairs_and_over_scenes_differ():
    pairs = [pair_of("a", 0, 1), pair_of("a", 0, 2), pair_of("a", 5, 2), pair_of("b", 0, 4)]
    rows = [row(1.0, 0.1, 0.1), row(1.0, 0.3, 0.1, "undecided"), row(20.0, 0.1, 0.3), row(2.0, 0.2, 0.5)]
    found = summarise_recall(suite_of(*pairs), pairs, rows)
    errors, rmse = found["errors"], found["rmse"]
    assert (errors["num_pairs"], errors["recall"], errors["accepted_recall"]) == (4, 0.75, 0.5)
    assert errors["recall_mean_over_groups"] == pytest.approx((2 / 3 + 1.0) / 2)
    assert errors["groups"]["a"] == {"num_pairs": 3, "recall": pytest.approx(2 / 3), "accepted_recall": 1 / 3}
    assert errors["translation_error_m_mean"] == pytest.approx(0.2)
    # the pair 0 1 is of neighbours in time; 5 2 is not, whichever comes first
    assert (rmse["num_pairs"], rmse["recall"], rmse["accepted_recall"]) == (3, pytest.approx(1 / 3), 0.0)
    assert rmse["recall_mean_over_groups"] == pytest.approx((0.5 + 0.0) / 2)


def test_a_definition_without_pairs_has_no_numbers():
    pairs = [pair_of("a", 0, 1)]
    found = summarise_recall(suite_of(*pairs), pairs, [row(1.0, 0.1, 0.1)])["rmse"]
    assert (found["num_pairs"], found["recall"], found["recall_mean_over_groups"]) == (0, None, None)
    assert found["groups"] == {}
