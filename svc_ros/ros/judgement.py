"""The node's answers beside the truth of a simulated drive: errors, a table, and what is wrong with them as a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.table import Table

from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.se3 import Array, invert, pose_error
from svc_ros.io.results import result_to_json
from svc_ros.io.stamps import ns_from_text
from svc_ros.ros.collector import result_from_decision

MAX_ROTATION_DEG, MAX_TRANSLATION_M = 5.0, 0.6  # an accepted pose beyond these is wrong
_COLOURS = {"accepted": "green", "rejected": "red", "undecided": "yellow", "dropped": "magenta"}


@dataclass(frozen=True, eq=False)
class ExpectedPair:
    """A pair that is going to be played: the stamps [ns] that were recorded, and where the source really is."""

    source_stamp_ns: int
    target_stamp_ns: int
    source_index: int
    target_index: int
    T_target_source: Array


@dataclass(frozen=True, eq=False)
class JudgedPair:
    """A decision beside the truth; errors are None where there is no pose to compare."""

    pair: ExpectedPair
    result: RegistrationResult
    values: dict[str, str]
    rotation_error_deg: float | None
    translation_error_m: float | None

    @property
    def is_wrong(self) -> bool:
        """Accepted, and not where the source really is."""
        if not self.result.accepted or self.rotation_error_deg is None or self.translation_error_m is None:
            return False
        return self.rotation_error_deg > MAX_ROTATION_DEG or self.translation_error_m > MAX_TRANSLATION_M


def expected_pairs(stamps_ns: NDArray[np.int64], poses: Array, stride: int) -> list[ExpectedPair]:
    """Pairs that the player makes of scans with these stamps (N,) and world poses (N, 4, 4)."""
    return [
        ExpectedPair(int(stamps_ns[k + stride]), int(stamps_ns[k]), k + stride, k, invert(poses[k]) @ poses[k + stride])
        for k in range(len(stamps_ns) - stride)
    ]


def judge(
    pairs: list[ExpectedPair], decisions: list[dict[str, str]], covariances: dict[int, Array]
) -> list[JudgedPair]:
    """Join decisions with their pairs by the source's stamp; covariances (6, 6) by that stamp.

    Raises InputError unless every pair has exactly one decision and every decision its pair.
    """
    by_stamp: dict[int, list[dict[str, str]]] = {pair.source_stamp_ns: [] for pair in pairs}
    for values in decisions:
        by_stamp.setdefault(ns_from_text(values["source_stamp"] or values["target_stamp"]), []).append(values)
    for number, (stamp_ns, found) in enumerate(by_stamp.items()):
        if len(found) != 1 or number >= len(pairs):
            expected = 1 if number < len(pairs) else 0
            raise InputError(f"the pair at {stamp_ns} ns has {len(found)} decisions, expected {expected}")
    return [_judged(pair, by_stamp[pair.source_stamp_ns][0], covariances) for pair in pairs]


def _judged(pair: ExpectedPair, values: dict[str, str], covariances: dict[int, Array]) -> JudgedPair:
    result = replace(result_from_decision(values), covariance=covariances.get(pair.source_stamp_ns))
    T = result.best_candidate if result.T_target_source is None else result.T_target_source
    errors = (None, None) if T is None else pose_error(T, pair.T_target_source)
    return JudgedPair(pair, result, values, *errors)


def verdict_on(judged: list[JudgedPair]) -> str | None:
    """What is wrong with the answers as a whole; None if nothing is."""
    wrong = [j for j in judged if j.is_wrong]
    if wrong:
        j = wrong[0]
        errors = f"{j.rotation_error_deg:.1f} deg, {j.translation_error_m:.2f} m"
        return f"{len(wrong)} wrong poses were accepted; the first is scan {j.pair.source_index} ({errors})"
    if not any(j.result.accepted for j in judged):
        return "no pair was accepted"
    if all(j.result.accepted for j in judged):
        return "no pair was rejected, although the drive has a jump"
    return None


def decisions_table(judged: list[JudgedPair]) -> Table:
    """The decisions for a person."""
    caption = "deg off, m off: distance of the candidate pose from the simulated truth"
    table = Table(title="decisions of /svc_registration", caption=caption, box=box.SIMPLE_HEAD, pad_edge=False)
    table.padding = (0, 1, 0, 0)
    table.add_column("scans", no_wrap=True)
    for name in ("verdict", "reason"):
        table.add_column(name, no_wrap=True)
    for name in ("deg off", "m off", "overlap", "denied", "ms"):
        table.add_column(name, justify="right", no_wrap=True)
    for j in judged:
        evidence = j.result.evidence.numbers() if j.result.evidence is not None else {}
        colour = "bold white on red" if j.is_wrong else _COLOURS[j.result.verdict.value]
        table.add_row(
            f"{j.pair.source_index} to {j.pair.target_index}",
            f"[{colour}]{j.result.verdict.value}[/]", j.result.reason.value,
            _number(j.rotation_error_deg, 2), _number(j.translation_error_m, 2),
            _number(evidence.get("oriented_overlap_ratio"), 2), _number(evidence.get("denied_ratio"), 3),
            _number(j.result.time_ms.get("total"), 0),
        )  # fmt: skip
    return table


def record_of(judged: JudgedPair) -> dict[str, Any]:
    """One line of decisions.jsonl: the result, which pair it is about, and how far it is off."""
    pair = judged.pair
    return result_to_json(
        judged.result,
        source_index=pair.source_index,
        target_index=pair.target_index,
        source_stamp_ns=pair.source_stamp_ns,
        target_stamp_ns=pair.target_stamp_ns,
        rotation_error_deg=judged.rotation_error_deg,
        translation_error_m=judged.translation_error_m,
    )


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
