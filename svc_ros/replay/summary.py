"""The numbers of one replayed bag, and of several together."""

from __future__ import annotations

import dataclasses
import platform
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

import numpy as np

import svc_ros
from svc_ros.core.result import RegistrationResult, Verdict
from svc_ros.evaluation.bag_reference import MAX_ROTATION_DEG, MAX_TRANSLATION_M, Reference, trajectory_errors
from svc_ros.evaluation.metrics import percentile
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.agreement import ORIGIN, pair_of
from svc_ros.replay.clouds import ReplayedPair, ReplayStep

_PACKAGES = ("numpy", "scipy", "numba", "open3d", "open3d-cpu", "kiss-icp", "rosbags", "evo")
Errors = tuple[float, float]


@dataclass
class Tally:
    """Counts what a replay decided; of two words on one loop the last one. Errors are rotation [deg] and translation
    [m]."""

    num_scans: int = 0
    num_revised: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    details: dict[str, str] = field(default_factory=dict)
    last: dict[tuple[int, int], tuple[RegistrationResult, Errors | None]] = field(default_factory=dict)
    accepted_errors: list[Errors] = field(default_factory=list)
    without_reference: int = 0
    frame_id: str = ""
    stage_ms: dict[str, list[float]] = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int | None = None

    def add_step(self, step: ReplayStep) -> None:
        """Count a cloud and the stages that every cloud goes through."""
        self.frame_id = self.frame_id or step.cloud.frame_id
        self.num_scans += 1
        self.first_ns = step.cloud.bag_time_ns if self.first_ns is None else self.first_ns
        self.last_ns = step.cloud.bag_time_ns
        for name, ms in step.time_ms.items():
            self.stage_ms.setdefault(f"scan.{name}", []).append(ms)

    def add_decision(self, decision: ReplayedPair, errors: Errors | None) -> None:
        """Count a decision, and the error of an accepted one; None where there is no reference for it."""
        pair = pair_of(decision)
        if decision.origin == ORIGIN:
            self.num_revised += 1
            self._count(*self.last[pair], -1)
        else:
            for name, ms in decision.result.time_ms.items():
                self.stage_ms.setdefault(name, []).append(ms)
        if pair[0] == pair[1]:
            self._count(decision.result, None, 1, is_pair=False)
        else:
            self._count(decision.result, errors, 1)
            self.last[pair] = dataclasses.replace(decision.result, evidence=None), errors

    def _count(self, result: RegistrationResult, errors: Errors | None, num: int, is_pair: bool = True) -> None:
        """Count a result once more, or take it back where `num` is -1."""
        self.verdicts[result.verdict.value] += num
        self.reasons[result.reason.value] += num
        self.details.setdefault(result.reason.value, result.detail)
        if not (result.accepted and is_pair):
            return
        if errors is None:
            self.without_reference += num
        elif num > 0:
            self.accepted_errors.append(errors)
        else:
            self.accepted_errors.remove(errors)

    @property
    def recorded_s(self) -> float:
        """Time of recording [s] from the first to the last cloud."""
        return 0.0 if self.first_ns is None or self.last_ns is None else 1e-9 * (self.last_ns - self.first_ns)

    @property
    def num_false(self) -> int:
        """Accepted poses that are beyond the borders of a right one."""
        return sum(deg > MAX_ROTATION_DEG or m > MAX_TRANSLATION_M for deg, m in self.accepted_errors)

    def numbers(self) -> dict[str, Any]:
        """Counts by verdict (all of them) and by reason (those that occurred, each with its first detail), and times by
        stage."""
        return {
            "num_scans": self.num_scans,
            "num_decisions": self.verdicts.total(),
            "verdicts": {verdict.value: self.verdicts[verdict.value] for verdict in Verdict},
            "reasons": {reason: num for reason, num in sorted(self.reasons.items()) if num},
            "details": {reason: self.details[reason] for reason, num in sorted(self.reasons.items()) if num},
            "num_revised": self.num_revised,
            "latency_ms": {name: _median_and_p95(values) for name, values in sorted(self.stage_ms.items())},
        }

    def reference_numbers(self) -> dict[str, Any]:
        """How far accepted poses are from the reference."""
        rotation, translation = zip(*self.accepted_errors, strict=True) if self.accepted_errors else ((), ())
        return {
            "thresholds": {"rotation_deg": MAX_ROTATION_DEG, "translation_m": MAX_TRANSLATION_M},
            "num_accepted_compared": len(self.accepted_errors),
            "num_accepted_without_reference": self.without_reference,
            "num_false_accepted": self.num_false,
            "rotation_error_deg": _spread(rotation),
            "translation_error_m": _spread(translation),
        }


def trajectory_numbers(trajectory: Trajectory, reference: Reference, frame_id: str) -> dict[str, Any]:
    """APE and RPE of the poses for which there is a reference; see `trajectory_errors`."""
    truth = [reference.pose(int(stamp), frame_id) for stamp in trajectory.stamps_ns]
    known = [k for k, pose in enumerate(truth) if pose is not None]
    found = np.array([pose for pose in truth if pose is not None]).reshape(-1, 4, 4)
    return trajectory_errors(trajectory.stamps_ns[known], trajectory.poses[known], found)


def versions() -> dict[str, str]:
    """Versions of the package, of Python and of what computes and reads."""
    found = {"svc_ros": svc_ros.__version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def combine(summaries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts over all bags. Wall times are added, as if one bag had followed the other."""
    verdicts, reasons = _sum(s["verdicts"] for s in summaries), _sum(s["reasons"] for s in summaries)
    recorded, wall = (sum(s[name] for s in summaries) for name in ("recorded_s", "wall_time_s"))
    total: dict[str, Any] = {
        "num_bags": len(summaries),
        "num_scans": sum(s["num_scans"] for s in summaries),
        "num_decisions": sum(s["num_decisions"] for s in summaries),
        "verdicts": verdicts,
        "reasons": reasons,
        "recorded_s": recorded,
        "wall_time_s": wall,
        "real_time_factor": recorded / wall if wall else None,
        "interrupted": any(s["state"] != "complete" for s in summaries),
    }
    if compared := [s["reference"]["num_false_accepted"] for s in summaries if s.get("reference")]:
        total["num_false_accepted"] = sum(compared)
    if loops := [s["false_loops"] for s in summaries if "false_loops" in s]:
        total["false_loops"] = sum(loops)
    return total


def _sum(counts: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for each in counts:
        total.update(each)
    return dict(total)


def _median_and_p95(values: Sequence[float]) -> dict[str, float | None]:
    return {"median": percentile(values, 50), "p95": percentile(values, 95)}


def _spread(values: Sequence[float]) -> dict[str, float | None]:
    return {**_median_and_p95(values), "max": max(values, default=None)}
