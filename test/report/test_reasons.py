"""The texts of reasons and verdicts: complete, and the same as in docs/reference.md."""

from __future__ import annotations

from pages import rows

from svc_ros.core.result import Reason, Verdict
from svc_ros.report.reasons import REASON_TEXTS, VERDICT_TEXTS


def test_every_reason_and_verdict_has_its_text():
    assert list(REASON_TEXTS) == list(Reason)
    assert list(VERDICT_TEXTS) == list(Verdict)


def test_the_reference_prints_the_same_words():
    printed = {code.strip("`"): (meaning, advice) for code, _, meaning, advice in rows("reasons")}
    for reason, text in REASON_TEXTS.items():
        assert tuple(cell.replace("`", "") for cell in printed[reason.value]) == tuple(text), reason
