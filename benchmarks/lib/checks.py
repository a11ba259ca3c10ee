"""Kernels beside their twins: first the same answer, then the times of both in turns."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from lib.cases import Case, SizedPair, thin_pair
from lib.timing import exponent, medians, time_in_turns
from lib.twins import KdObserver, dense_hypotheses, look_by_trees, paper_by_trees
from svc_ros.core import se3
from svc_ros.core.config import HypothesisConfig, SightViewConfig
from svc_ros.core.scan import Array, Correspondences, HypothesisSet, PreparedScan
from svc_ros.core.search.hypotheses import generate_hypotheses
from svc_ros.core.sight import paper_rule
from svc_ros.core.sight.evidence import SightLines
from svc_ros.core.sight.placement import place
from svc_ros.core.sight.sight_view import find_blocked

OURS, TWIN, PAPER, PAPER_TWIN = "svc_ros", "cKDTree", "paper, svc_ros", "paper, cKDTree"
DENSE = "dense numpy"
Look = tuple[SightLines, Array]
_ROUNDED = 5e-4
_CALLS = 15  # of every check in its turn, whatever its size


class DisagreementError(RuntimeError):
    """A kernel and its twin answer differently: their times say nothing."""


def look_one_way(observer: PreparedScan, other: PreparedScan, T_observer_other: Array, config: SightViewConfig) -> Look:
    """One sight-view check in one direction: the blocked lines, and how much of the other scan agrees."""
    placement = place(observer, other, T_observer_other, config)
    return find_blocked(observer, placement, config), np.array(placement.shares())


def compare_checks(cases: Sequence[Case], numbers: Sequence[int], check_at: int, rounds: int) -> dict[str, Any]:
    """Sight-view checks of all cases, at the right pose and at a wrong one, against points and against their twins.

    Speed-ups are of the time of all checks together. The exponent is the largest of any check.
    """
    curves: dict[str, dict[str, Any]] = {}
    for case in cases:
        pairs = {num: thin_pair(case, num) for num in sorted({*numbers, check_at})}
        for pose, T in (("right pose", case.T_target_source), ("wrong pose", case.wrong_pose)):
            jobs = {(num, name): job for num, pair in pairs.items() for name, job in check_jobs(pair, T).items()}
            curves[f"{case.name}, {pose}"] = _curves(medians(time_in_turns(jobs, rounds, _CALLS)), numbers, check_at)
    at = {name: [curve["at"][name] for curve in curves.values()] for name in (OURS, TWIN, PAPER, PAPER_TWIN)}
    return {
        "speedup_vs_kdtree_10k": sum(at[TWIN]) / sum(at[OURS]),
        "smallest_speedup_vs_kdtree_10k": min(t / o for o, t in zip(at[OURS], at[TWIN], strict=True)),
        "paper_speedup_vs_kdtree_10k": sum(at[PAPER_TWIN]) / sum(at[PAPER]),
        "exponent": max(curve["exponent"] for curve in curves.values()),
        "time_ms_10k": float(np.mean(at[OURS])),
        "kdtree_time_ms_10k": float(np.mean(at[TWIN])),
        "points": check_at,
        "curves": curves,
    }


def check_jobs(pair: SizedPair, T: Array) -> dict[str, Callable[[], Any]]:
    """One direction, target prepared, ours and the twin's, both rules; DisagreementError if they do not agree."""
    settings, paper = pair.config.sight_view, pair.config.paper
    observer = KdObserver.build(pair.target, settings)
    jobs: dict[str, Callable[[], Any]] = {
        OURS: lambda: look_one_way(pair.target, pair.source, T, settings),
        TWIN: lambda: look_by_trees(observer, pair.source, T, settings),
        PAPER: lambda: paper_rule.find_blocked(pair.target, se3.apply(T, pair.source.points), paper),
        PAPER_TWIN: lambda: paper_by_trees(observer, se3.apply(T, pair.source.points), paper),
    }
    ours, twin = jobs[OURS](), jobs[TWIN]()
    require_same_lines(ours[0], twin[0])
    require_same_lines(jobs[PAPER](), jobs[PAPER_TWIN](), exactly=True)
    if not np.allclose(ours[1], twin[1], rtol=0.0, atol=_ROUNDED):
        raise DisagreementError(f"shares of the placed scan: {ours[1]}, the twin says {twin[1]}")
    return jobs


def require_same_lines(ours: SightLines, twin: SightLines, exactly: bool = False) -> None:
    """Raise DisagreementError unless the same lines are blocked by the same points.

    The default mode finds surface in float32: a point at the border, to a hundredth of a millimetre, may lie on it for
    one and not for the other, so that up to _ROUNDED of the lines may differ.
    """
    allowed = 0 if exactly else round(_ROUNDED * ours.num_lines)
    for name in ("num_lines", "num_observed"):
        if abs(getattr(ours, name) - getattr(twin, name)) > allowed:
            raise DisagreementError(f"{name}: {getattr(ours, name)}, the twin says {getattr(twin, name)}")
    a, b = (set(zip(lines.blocked_idx.tolist(), lines.blocker_idx.tolist(), strict=True)) for lines in (ours, twin))
    if len(a ^ b) > 2 * allowed:
        raise DisagreementError(f"{len(a ^ b)} of {ours.num_blocked} and {twin.num_blocked} blocked lines differ")


def compare_hypotheses(matches: Correspondences, config: HypothesisConfig, rounds: int) -> dict[str, Any]:
    """Generation from N correspondences against dense matrices."""
    ours = functools.partial(generate_hypotheses, matches, config)
    twin = functools.partial(dense_hypotheses, matches, config)
    found = ours()
    require_same_hypotheses(found, twin())
    times = medians(time_in_turns({OURS: ours, DENSE: twin}, rounds))
    return {
        "speedup_vs_dense_5000": times[DENSE] / times[OURS],
        "time_ms": times[OURS],
        "dense_time_ms": times[DENSE],
        "correspondences": len(matches),
        "hypotheses": len(found),
    }


def require_same_hypotheses(ours: HypothesisSet, twin: HypothesisSet) -> None:
    """Raise DisagreementError unless the same poses come out, in whatever order equally good ones stand."""
    if len(ours) != len(twin) or not np.array_equal(np.sort(ours.num_inliers), np.sort(twin.num_inliers)):
        raise DisagreementError(f"{len(ours)} and {len(twin)} hypotheses, or inliers, differ")
    a, b = (_ordered(h) for h in (ours, twin))
    if not np.allclose(a, b, rtol=0.0, atol=1e-6):
        raise DisagreementError(f"poses differ by up to {np.abs(a - b).max():.3g}")


def _ordered(hypotheses: HypothesisSet) -> Array:
    T = hypotheses.T_target_source.reshape(-1, 16)
    return T[np.lexsort((*T[:, (3, 7, 11)].round(5).T, hypotheses.num_inliers))]


def _curves(times: Mapping[tuple[int, str], float], numbers: Sequence[int], check_at: int) -> dict[str, Any]:
    names = (OURS, TWIN, PAPER, PAPER_TWIN)
    ours = [times[num, OURS] for num in numbers]
    return {
        "number": list(numbers),
        "time_ms": {name: [times[num, name] for num in numbers] for name in names},
        "at": {name: times[check_at, name] for name in names},
        "exponent": exponent(numbers, ours),
    }
