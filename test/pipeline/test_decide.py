"""Whatever goes wrong with a pair has one name, the same for node, replay and evaluation."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from svc_ros.core.config import preset
from svc_ros.core.errors import (
    ConfigError,
    InputError,
    MissingDependencyError,
    TooFewPointsError,
    TransformUnavailableError,
    UnsupportedCloudError,
)
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.scan import Scan
from svc_ros.pipeline import decide

CONFIG = preset("lidar_outdoor")


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (TooFewPointsError("12 points, expected 100"), Reason.TOO_FEW_POINTS),
        (UnsupportedCloudError("field x is missing"), Reason.UNSUPPORTED_CLOUD),
        (InputError("shape"), Reason.UNSUPPORTED_CLOUD),
        (TransformUnavailableError("map -> lidar"), Reason.TF_UNAVAILABLE),
    ],
)
def test_errors_of_the_family_keep_their_text(error, reason):
    result = decide.refused(error, CONFIG)
    assert (result.verdict, result.reason, result.detail) == (Verdict.REJECTED, reason, str(error))
    assert result.method == "svc"
    assert result.T_target_source is None


def test_other_errors_are_internal_and_logged_with_a_traceback(caplog):
    with caplog.at_level(logging.ERROR):
        result = decide.refused(ZeroDivisionError("float division by zero"), CONFIG)
    assert (result.verdict, result.reason) == (Verdict.REJECTED, Reason.INTERNAL_ERROR)
    assert result.detail == "ZeroDivisionError: float division by zero"
    assert "ZeroDivisionError" in caplog.text


def test_scan_with_three_points_is_a_decision():
    scan = Scan(np.eye(3) * 10)
    result = decide.register_pair(scan, scan, CONFIG)
    assert (result.verdict, result.reason) == (Verdict.REJECTED, Reason.TOO_FEW_POINTS)
    assert "points" in result.detail


def test_defect_in_the_registration_is_a_decision(monkeypatch):
    def broken(*_args):
        raise RuntimeError("boom")

    monkeypatch.setattr(decide, "register", broken)
    scan = Scan(np.eye(3))
    assert decide.register_pair(scan, scan, CONFIG).detail == "RuntimeError: boom"


@pytest.mark.parametrize("error", [ConfigError("method"), MissingDependencyError("open3d")])
def test_what_no_pair_can_survive_is_raised(monkeypatch, error):
    def broken(*_args):
        raise error

    monkeypatch.setattr(decide, "register", broken)
    scan = Scan(np.eye(3))
    with pytest.raises(type(error)):
        decide.register_pair(scan, scan, CONFIG)


def test_dropped_pair_has_a_reason_and_no_pose():
    result = decide.dropped(Reason.SUPERSEDED, "a newer pair came", "svc")
    assert (result.verdict, result.reason, result.detail) == (Verdict.DROPPED, Reason.SUPERSEDED, "a newer pair came")
    assert result.best_candidate is None
