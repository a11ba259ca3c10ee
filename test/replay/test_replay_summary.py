"""The numbers of a replay."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from test_replay_track import SECOND, link, step

import svc_ros
from svc_ros.replay.summary import Tally, versions

STAMPS = [k * SECOND for k in range(5)]


def test_counts_and_times() -> None:
    tally = Tally()
    for k in range(5):
        tally.add_step(step(k, STAMPS, []))
    tally.add_decision(link(1, 0, 1.0, STAMPS), None)
    tally.add_decision(link(2, 1, None, STAMPS), None)
    numbers = tally.numbers()
    assert (numbers["num_scans"], numbers["num_decisions"], tally.recorded_s) == (5, 2, pytest.approx(4.0))
    assert numbers["verdicts"] == {"accepted": 1, "rejected": 1, "undecided": 0, "dropped": 0}
    assert numbers["reasons"] == {"low_overlap": 1, "ok": 1}
    assert json.loads(json.dumps(numbers)) == numbers


def test_stages_have_median_and_p95() -> None:
    tally = Tally()
    for ms in range(1, 101):
        cloud = dataclasses.replace(step(0, STAMPS, []), time_ms={"read": float(ms)})
        tally.add_step(cloud)
        decision = link(1, 0, 1.0, STAMPS)
        result = dataclasses.replace(decision.result, time_ms={"matching": 2.0 * ms, "total": 3.0 * ms})
        tally.add_decision(dataclasses.replace(decision, result=result), None)
    latency = tally.numbers()["latency_ms"]
    assert set(latency) == {"scan.read", "matching", "total"}
    assert latency["total"]["median"] == pytest.approx(3.0 * 50.5)
    assert latency["scan.read"]["p95"] == pytest.approx(np.percentile(np.arange(1, 101), 95))


@pytest.mark.parametrize(("errors", "false"), [((5.0, 0.6), 0), ((5.1, 0.0), 1), ((0.0, 0.61), 1)])
def test_false_is_what_is_beyond_either_border(errors: tuple[float, float], false: int) -> None:
    tally = Tally()
    tally.add_decision(link(1, 0, 1.0, STAMPS), errors)
    tally.add_decision(link(2, 1, None, STAMPS), (90.0, 9.0))  # rejected: not false
    tally.add_decision(link(3, 2, 1.0, STAMPS), None)
    tally.add_decision(link(0, 0, 0.0, STAMPS), (0.0, 0.0))  # the first scan of a stream: compared with nothing
    numbers = tally.reference_numbers()
    assert numbers["num_false_accepted"] == false == tally.num_false
    assert (numbers["num_accepted_compared"], numbers["num_accepted_without_reference"]) == (1, 1)
    assert numbers["translation_error_m"]["max"] == errors[1]


def test_no_decision_is_no_number() -> None:
    assert Tally().numbers()["latency_ms"] == {}
    assert Tally().reference_numbers()["rotation_error_deg"] == {"median": None, "p95": None, "max": None}
    assert Tally().recorded_s == 0.0


def test_versions_name_the_package_and_what_it_stands_on() -> None:
    found = versions()
    assert found["svc_ros"] == svc_ros.__version__
    assert {"python", "numpy", "numba", "rosbags"} <= set(found)
