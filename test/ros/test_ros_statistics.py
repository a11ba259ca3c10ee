"""What the node counts of its decisions, and that a fault ends when its cause has."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.ros.diagnostics import Statistics
from svc_ros.ros.streams.decision import Decision


@pytest.mark.parametrize(
    "next_ones", [[], [Decision(RegistrationResult(Verdict.UNDECIDED, Reason.AMBIGUOUS), None, None)]]
)
def test_a_fault_is_over_with_the_next_scan_that_has_none_even_if_it_has_no_decision(next_ones):
    statistics = Statistics({"points": True})
    lost = RegistrationResult(Verdict.REJECTED, Reason.TF_UNAVAILABLE, detail="no transform")
    statistics.finish([Decision(lost, None, None)])
    assert statistics.fault == "tf_unavailable: no transform"
    statistics.finish(next_ones)
    assert statistics.fault == ""
