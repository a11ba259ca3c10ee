"""Decisions of an earlier run, taken as they are: only what a file does not keep is measured once more."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterable

from svc_ros.core.config import Config
from svc_ros.core.registration import verify
from svc_ros.core.result import Reason, RegistrationResult
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.sight.sight_view import gather_evidence
from svc_ros.pipeline.agreement import ORIGIN
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.loop_closure import judge_candidate
from svc_ros.pipeline.stream import StreamDecision


def look_again(
    result: RegistrationResult, source: PreparedScan, target: PreparedScan, config: Config
) -> RegistrationResult:
    """The result with the evidence of its pose measured again: a file keeps how many sight lines are blocked only.

    That takes a twentieth of a registration. A result without a pose stays as it is.
    """
    T = result.best_candidate
    if T is None:
        return result
    if config.method == "svc_paper":  # which counts blocked lines in its own way, and refines no pose
        return dataclasses.replace(result, evidence=verify(source, target, T, config).evidence)
    return dataclasses.replace(result, evidence=gather_evidence(source, target, T, config.sight_view))


class KnownLoops:
    """Judges candidates for loops: those that were judged before as they were, others as `judge_candidate` does.

    What is not confirmed is judged anew, because its decision no longer tells what the pair said by itself.
    """

    def __init__(self, known: Iterable[StreamDecision]) -> None:
        self._results: dict[tuple[int, int], deque[RegistrationResult]] = {}
        for d in known:
            if d.origin == ORIGIN or d.result.reason is Reason.UNCONFIRMED:
                continue
            self._results.setdefault((d.source_stamp_ns, d.target_stamp_ns), deque()).append(d.result)

    def __call__(
        self, source: Keyframe, target: Keyframe, T_target_source: Array | None, config: Config
    ) -> RegistrationResult:
        """See `judge_candidate`."""
        known = self._results.get((source.scan.stamp_ns, target.scan.stamp_ns))
        if not known:
            return judge_candidate(source, target, T_target_source, config)
        return look_again(known.popleft(), source.scan, target.scan, config)
