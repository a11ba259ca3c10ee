"""Every piece of evidence ends in one verdict with one reason, and clear cases end where they must."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from svc_ros.core import decision
from svc_ros.core.config import PRESETS, DecisionConfig, preset
from svc_ros.core.evidence import SightLines, SightViewEvidence
from svc_ros.core.result import Reason, Verdict


def evidence(
    blocked: float = 0.0, overlap: float = 0.9, oriented: float | None = None, opposed: float = 0.0, other: float = 0.0
) -> SightViewEvidence:
    """1000 sight lines each way with shares as given."""
    lines = [SightLines(1000, 1000, *[np.arange(round(share * 1000))] * 2) for share in (blocked, other)]
    return SightViewEvidence(*lines, overlap, overlap if oriented is None else oriented, opposed)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(
    ("case", "verdict"),
    [
        (evidence(), Verdict.ACCEPTED),
        (evidence(overlap=0.0), Verdict.REJECTED),
        (evidence(blocked=0.8), Verdict.REJECTED),
        (evidence(other=0.8), Verdict.REJECTED),
        (evidence(overlap=0.9, oriented=0.0, opposed=0.9), Verdict.REJECTED),
    ],
    ids=["clear", "no_contact", "target_blocked", "source_blocked", "inside_out"],
)
def test_clear_cases(name, case, verdict):
    decided = decision.decide(case, preset(name).decision)
    assert decided.verdict is verdict
    assert (decided.reason is Reason.OK) is (verdict is Verdict.ACCEPTED)
    assert decided.detail


def test_every_evidence_has_an_answer():
    shares = (0.0, 0.01, 0.05, 0.1, 0.3, 0.6, 1.0)
    for blocked, other, oriented, opposed in itertools.product(shares, repeat=4):
        decided = decision.decide(evidence(blocked, 1.0, oriented, opposed, other), DecisionConfig())
        assert 0.0 <= decided.probability <= 1.0
        assert (decided.verdict is Verdict.ACCEPTED) is (decided.reason is Reason.OK)


@pytest.mark.parametrize("share", ["blocked", "other", "opposed"])
def test_more_contradiction_never_helps(share):
    verdicts = [
        decision.decide(evidence(**{share: value}), DecisionConfig()).verdict is Verdict.ACCEPTED
        for value in np.linspace(0, 1, 101)
    ]
    assert verdicts[0]
    assert verdicts == sorted(verdicts, reverse=True)


def test_contact_is_good_and_blocking_is_bad_for_the_score():
    assert decision.score(evidence(overlap=0.5)) > decision.score(evidence(overlap=0.3))
    assert decision.score(evidence(blocked=0.1)) < decision.score(evidence())
    assert decision.score(evidence(other=0.1)) < decision.score(evidence())
