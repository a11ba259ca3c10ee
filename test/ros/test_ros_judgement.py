"""The demo's judgement of the node's answers."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rich.console import Console

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.se3 import make_pose
from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence
from svc_ros.ros.collector import result_from_decision
from svc_ros.ros.judgement import decisions_table, expected_pairs, judge, record_of, verdict_on
from svc_ros.ros.streams.registrar import Decision
from svc_ros.ros.streams.worker import CloudLabel
from svc_ros.ros.topics.outputs import _values as values_of

NS = 1_000_000_000
POSES = np.stack([make_pose(np.eye(3), (x, 0.0, 0.0)) for x in (0.0, 1.0, 50.0, 51.0)])
PAIRS = expected_pairs(np.arange(1, 5) * NS, POSES, stride=1)


def evidence():
    lines = SightLines(100, 40, np.arange(7), np.arange(7))
    other = SightLines(90, 30, np.arange(0), np.arange(0))
    surfaces = (SeenSurface(90, 60, np.arange(4), 1.5, 6, 9), SeenSurface(100, 60, np.arange(0), 0.0, 20, 15))
    return SightViewEvidence(lines, other, 0.8, 0.7, 0.05, 0.2, 0.25, 0.9, *surfaces)


def answer(pair, x_error_m=0.0, accepted=True):
    """What the node says of a pair, with a pose that is off by so much."""
    T = pair.T_target_source.copy()
    T[0, 3] += x_error_m
    if accepted:
        result = RegistrationResult(Verdict.ACCEPTED, Reason.OK, "svc", T, T, None, 0.9, evidence(), {"judged": 2},
                                    {"total": 12.0})  # fmt: skip
    else:
        result = RegistrationResult(Verdict.REJECTED, Reason.LOW_OVERLAP, "svc", best_candidate=T, evidence=evidence())
    label = CloudLabel(pair.source_stamp_ns, "lidar")
    return values_of(Decision(result, label, label, {"latency_ms": 20.0}))


def test_result_is_read_back_from_a_decision():
    result = result_from_decision(answer(PAIRS[0]))
    assert (result.verdict, result.reason, result.method) == (Verdict.ACCEPTED, Reason.OK, "svc")
    assert np.array_equal(result.T_target_source, PAIRS[0].T_target_source)
    assert result.evidence.numbers() == pytest.approx(evidence().numbers(), abs=1e-8)  # nine digits are told
    assert result.evidence.denied_ratio == pytest.approx(4 / 124)
    assert (result.probability, result.counts, result.time_ms) == (0.9, {"judged": 2}, {"total": 12.0})


def test_number_that_is_none_is_refused_by_name():
    with pytest.raises(InputError, match="overlap_ratio"):
        result_from_decision({**answer(PAIRS[0]), "overlap_ratio": "much"})


def test_dropped_cloud_is_read_back_too():
    result = RegistrationResult(Verdict.DROPPED, Reason.TIME_SKEW, "svc", detail="no target")
    values = values_of(Decision(result, CloudLabel(NS, "lidar"), None))
    assert (values["source_stamp"], values["target_stamp"], values["target_frame"]) == ("1.000000000", "", "")
    assert result_from_decision(values).reason is Reason.TIME_SKEW


def test_right_answers_pass():
    decisions = [answer(PAIRS[0]), answer(PAIRS[1], accepted=False), answer(PAIRS[2], 0.1)]
    judged = judge(PAIRS, decisions, {})
    assert verdict_on(judged) is None
    assert [round(j.translation_error_m, 6) for j in judged] == [0.0, 0.0, 0.1]
    assert np.allclose(PAIRS[0].T_target_source[:3, 3], (1, 0, 0))


@pytest.mark.parametrize(
    ("errors_m", "accepted", "text"),
    [
        ((0.0, 3.0, 0.0), (True, True, True), r"1 wrong poses were accepted; the first is scan 2 \(0.0 deg, 3.00 m\)"),
        ((0.0, 0.0, 0.0), (False, False, False), "no pair was accepted"),
        ((0.0, 0.0, 0.0), (True, True, True), "no pair was rejected"),
    ],
)
def test_wrong_answers_are_named(errors_m, accepted, text):
    decisions = [answer(p, e, a) for p, e, a in zip(PAIRS, errors_m, accepted, strict=True)]
    assert re.search(text, verdict_on(judge(PAIRS, decisions, {})))


def test_missing_double_and_foreign_decisions_are_refused():
    decisions = [answer(pair) for pair in PAIRS]
    with pytest.raises(InputError, match="4000000000 ns has 0 decisions, expected 1"):
        judge(PAIRS, decisions[:2], {})
    with pytest.raises(InputError, match="2000000000 ns has 2 decisions, expected 1"):
        judge(PAIRS, [*decisions, decisions[0]], {})
    with pytest.raises(InputError, match="4000000000 ns has 1 decisions, expected 0"):
        judge(PAIRS[:2], decisions, {})


def test_record_has_the_result_the_pair_and_the_errors():
    (first, *_) = judge(PAIRS[:1], [answer(PAIRS[0], 0.25)], {2 * NS: np.eye(6)})
    record = record_of(first)
    assert (record["verdict"], record["source_index"], record["target_index"]) == ("accepted", 1, 0)
    assert (record["source_stamp_ns"], record["target_stamp_ns"]) == (2 * NS, NS)
    assert record["translation_error_m"] == pytest.approx(0.25)
    assert record["covariance"] == np.eye(6).tolist()


def test_table_shows_every_pair_once():
    text = io.StringIO()
    judged = judge(PAIRS, [answer(pair, accepted=k != 1) for k, pair in enumerate(PAIRS)], {})
    Console(file=text, width=140).print(decisions_table(judged))
    assert text.getvalue().count("accepted") == 2
    assert text.getvalue().count("low_overlap") == 1
