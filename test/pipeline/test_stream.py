"""The order of stamps in a stream, and the stricter demand on poses that a stream is built on."""

from __future__ import annotations

import numpy as np
import pytest

from svc_ros.core.config import Config
from svc_ros.core.errors import TooFewPointsError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.pipeline.stream import StampOrder, demand, drop_scan, refuse_scan

S = 1_000_000_000


def accepted(probability: float | None) -> RegistrationResult:
    T = np.eye(4)
    return RegistrationResult(
        Verdict.ACCEPTED, Reason.OK, "svc", T, T, np.eye(6), probability, detail="free sight lines"
    )


def test_growing_stamps_are_in_order() -> None:
    order = StampOrder()
    for stamp in (5 * S, 5 * S + 1, 900 * S):
        assert not order.is_jump(stamp)
        assert order.lateness(stamp) == ""


@pytest.mark.parametrize("back_ns", [0, 1, S // 2, S])
def test_a_small_step_back_is_late_and_moves_nothing(back_ns: int) -> None:
    order = StampOrder()
    order.lateness(10 * S)
    assert not order.is_jump(10 * S - back_ns)
    assert "before that of an earlier scan" in order.lateness(10 * S - back_ns)
    assert order.lateness(10 * S + 1) == ""


def test_a_jump_back_begins_anew() -> None:
    order = StampOrder()
    order.lateness(10 * S)
    assert order.is_jump(9 * S - 1)
    assert order.lateness(9 * S - 1) == ""
    assert order.lateness(9 * S) == ""


def test_a_cleared_order_takes_any_stamp() -> None:
    order = StampOrder()
    order.lateness(10 * S)
    order.clear()
    assert not order.is_jump(1)
    assert order.lateness(1) == ""


@pytest.mark.parametrize("probability", [0.8, 0.75, None])
def test_a_probable_pose_meets_the_demand(probability: float | None) -> None:
    result = accepted(probability)
    assert demand(result, 0.75) is result


def test_a_less_probable_pose_is_left_undecided_with_its_numbers() -> None:
    result = demand(accepted(0.7), 0.75)
    assert (result.verdict, result.reason) == (Verdict.UNDECIDED, Reason.INSUFFICIENT_EVIDENCE)
    assert result.T_target_source is None
    assert result.covariance is None
    np.testing.assert_array_equal(result.best_candidate, np.eye(4))
    assert result.probability == 0.7
    assert "0.70" in result.detail
    assert "free sight lines" in result.detail


def test_what_is_not_accepted_stays_as_it_is() -> None:
    result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, probability=0.1)
    assert demand(result, 0.75) is result


def test_scans_that_are_not_used_have_decisions_too() -> None:
    refused = refuse_scan(7, "lidar", TooFewPointsError("5 points"), Config())
    assert (refused.result.verdict, refused.result.reason) == (Verdict.REJECTED, Reason.TOO_FEW_POINTS)
    late = drop_scan(8, "lidar", Reason.STALE, "late")
    assert (late.result.verdict, late.result.reason) == (Verdict.DROPPED, Reason.STALE)
    for decision, stamp in ((refused, 7), (late, 8)):
        assert (decision.source_stamp_ns, decision.target_stamp_ns) == (stamp, stamp)
        assert (decision.source_frame, decision.T_odom_source) == ("lidar", None)
