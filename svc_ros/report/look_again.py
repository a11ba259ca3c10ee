"""What is behind a decision that was read from JSON, which tells how many lines and points there are but not which."""

from __future__ import annotations

import dataclasses

from svc_ros.core.config import Config
from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.sight.evidence import SightViewEvidence
from svc_ros.core.sight.paper_rule import check_both_ways
from svc_ros.core.sight.sight_view import gather_evidence

_FEW, _SHARE = 5, 0.05  # another machine rounds otherwise, and a line at the very border falls to its other side


def look_again(
    source: PreparedScan, target: PreparedScan, result: RegistrationResult, config: Config
) -> RegistrationResult:
    """The result with the indices of its blocked sight lines and denied points, found anew at the pose that it judged.

    Raises InputError where scans or configuration are visibly not those of the result: another number of points, or
    of blocked sight lines.
    """
    for side, scan in (("source", source), ("target", target)):
        expected = result.counts.get(f"{side}_points", len(scan))
        if expected != len(scan):
            raise InputError(f"expected a {side} of {expected} points after preparation, found {len(scan)}")
    if result.best_candidate is None or result.evidence is None:
        return result
    evidence = _evidence(source, target, result.best_candidate, config)
    for name in ("source_in_target", "target_in_source"):
        told, seen = (getattr(e, name).num_blocked for e in (result.evidence, evidence))
        if abs(told - seen) > max(_FEW, _SHARE * told):
            raise InputError(f"expected {told} blocked sight lines ({name}) at the judged pose, found {seen}")
    return dataclasses.replace(result, evidence=evidence)


def _evidence(source: PreparedScan, target: PreparedScan, T: Array, config: Config) -> SightViewEvidence:
    seen = gather_evidence(source, target, T, config.sight_view)
    if config.method != "svc_paper":
        return seen
    in_target, in_source, _ = check_both_ways(source, target, T, config.paper)
    return dataclasses.replace(seen, source_in_target=in_target, target_in_source=in_source)
