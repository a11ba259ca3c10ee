"""From judged poses to what a calibration tells: what the border in use does, which to demand, how sure that is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from svc_ros.evaluation.calibration.claims import (
    Claim,
    JudgedPose,
    choose_claim,
    claim_at,
    curve,
    expected_calibration_error,
    pair_scores,
    pairs_needed,
    reliability_bins,
    surest_claim,
)
from svc_ros.evaluation.calibration.trials import REGISTER, Judged, Trial

Row = dict[str, Any]

_LISTED = 50  # wrong acceptances that are told one by one


@dataclass(frozen=True)
class Goal:
    """What is asked for: at most `max_wrong_rate` of pairs with a wrong acceptance, at this confidence, both in (0, 1).

    present: `decision.min_probability` of the configuration in use.
    """

    max_wrong_rate: float
    confidence: float
    present: float


@dataclass(frozen=True, eq=False)
class JudgedSet:
    """A data set's name, its trials, and what came of each."""

    name: str
    trials: Sequence[Trial]
    judged: Sequence[Judged]

    @property
    def poses(self) -> list[JudgedPose]:
        """All that were judged, without the grey ones."""
        return [pose for one in self.judged for pose in one.poses]


def summarise_calibration(sets: Sequence[JudgedSet], goal: Goal) -> Row:
    """All numbers of a calibration as JSON has them.

    `chosen` is null where the data cannot keep the promise; `surest` is the best that they can promise.
    """
    poses = [pose for one in sets for pose in one.poses]
    scores = list(pair_scores(poses).values())
    present = claim_at(goal.present, scores, goal.confidence)
    chosen = choose_claim(scores, goal.max_wrong_rate, goal.confidence)
    surest = surest_claim(scores, goal.confidence)
    borders = sorted({goal.present, (chosen or surest).min_probability})
    probability, correct = _told(poses)
    claims = {"present": present, "chosen" if chosen else "surest": chosen or surest}
    needed = pairs_needed(goal.max_wrong_rate, goal.confidence)
    return {
        "max_wrong_rate": goal.max_wrong_rate,
        "confidence": goal.confidence,
        **_counts(sets),
        "present": _border(present, poses),
        "chosen": None if chosen is None else _border(chosen, poses),
        "surest": _border(surest, poses),
        "num_pairs_needed": needed,
        "num_pairs_missing": 0 if chosen else max(0, needed - len(scores)),
        "datasets": [_of_set(one, claims) for one in sets],
        "register": _of_register(poses, borders, goal.confidence),
        "expected_calibration_error": expected_calibration_error(probability, correct),
        "expected_calibration_error_accepted": expected_calibration_error(*_told(p for p in poses if p.accepted)),
        "reliability": reliability_bins(probability, correct),
        "curve": curve(poses, goal.confidence, borders),
        "wrong_accepted": _wrong_accepted(poses),
    }


def _counts(sets: Iterable[JudgedSet]) -> Row:
    sets = list(sets)
    judged = [one for of_set in sets for one in of_set.judged]
    pairs = [(of_set.name, trial.pair) for of_set in sets for trial in of_set.trials]
    poses = [pose for one in judged for pose in one.poses]
    return {
        "num_pairs": len(pair_scores(poses)),
        "num_scans": len({(name, scan) for name, pair in pairs for scan in (pair.source, pair.target)}),
        "num_pairs_unusable": sum(bool(one.error) for one in judged),
        "num_right_poses": sum(pose.correct for pose in poses),
        "num_wrong_poses": sum(not pose.correct for pose in poses),
        "num_grey_poses": sum(one.num_grey for one in judged),
        "num_poses_by_kind": dict(sorted(Counter(pose.kind for pose in poses).items())),
    }


def _border(claim: Claim, poses: Sequence[JudgedPose]) -> Row:
    """What one demanded probability promises, and what it accepts."""
    accepted = [pose for pose in poses if pose.score >= claim.min_probability]
    wrong = Counter(pose.kind for pose in accepted if not pose.correct)
    return {
        "min_probability": claim.min_probability,
        "num_pairs": claim.num_pairs,
        "num_failed_pairs": claim.num_failed,
        "wrong_rate_bound": claim.bound,
        "num_wrong_accepted": sum(wrong.values()),
        "wrong_accepted_by_kind": dict(sorted(wrong.items())),
        "right_accepted_share": _right_share(poses, claim.min_probability),
    }


def _of_set(one: JudgedSet, claims: Mapping[str, Claim]) -> Row:
    """One data set alone, at each border; it promises nothing by itself."""
    poses = one.poses
    scores = list(pair_scores(poses).values())
    told: Row = {"dataset": one.name, **_counts([one])}
    for name, claim in claims.items():
        num_failed = sum(score >= claim.min_probability for score in scores)
        share = _right_share(poses, claim.min_probability)
        told[name] = {"num_failed_pairs": num_failed, "right_accepted_share": share}
    return told


def _of_register(poses: Sequence[JudgedPose], borders: Sequence[float], confidence: float) -> Row | None:
    """Whole registrations alone, at each border; None without any."""
    found = [pose for pose in poses if pose.kind == REGISTER]
    if not found:
        return None
    at = []
    for border in borders:
        wrong = [pose.score if not pose.correct else 0.0 for pose in found]
        claim = asdict(claim_at(border, wrong, confidence))
        num_right = sum(pose.correct and pose.score >= border for pose in found)
        at.append({
            "min_probability": border, "num_wrong_accepted": claim["num_failed"], "wrong_rate_bound": claim["bound"],
            "num_right_accepted": num_right,
        })  # fmt: skip
    return {"num_registrations": len(found), "num_right": sum(pose.correct for pose in found), "at": at}


def _told(poses: Iterable[JudgedPose]) -> tuple[list[float], list[bool]]:
    """Probability of every pose that has one, and whether it is correct."""
    pairs = [(pose.probability, pose.correct) for pose in poses if pose.probability is not None]
    return [probability for probability, _ in pairs], [correct for _, correct in pairs]


def _right_share(poses: Iterable[JudgedPose], min_probability: float) -> float | None:
    right = [pose.score >= min_probability for pose in poses if pose.correct]
    return sum(right) / len(right) if right else None


def _wrong_accepted(poses: Iterable[JudgedPose]) -> list[Row]:
    """The wrong poses that are accepted at the lowest border, most probable first: the ones to look at."""
    wrong = sorted((p for p in poses if not p.correct and p.score > 0.0), key=lambda p: (-p.score, p.dataset, p.pair))
    left_out = ("correct", "accepted")
    return [{k: v for k, v in asdict(pose).items() if k not in left_out} for pose in wrong[:_LISTED]]


def statement(summary: Row) -> str:
    """What can be promised, in words, and what is missing where that is not what was asked for."""
    confidence, asked = f"{percent(summary['confidence'])} confidence", percent(summary["max_wrong_rate"])
    found = summary["chosen"] or summary["surest"]
    seen = f"{found['num_failed_pairs']} of {found['num_pairs']} pairs have a wrong pose accepted"
    at = f"decision.min_probability {found['min_probability']:g}"
    bound = f"at most {percent(found['wrong_rate_bound'], up=True)} at {confidence}"
    if summary["chosen"]:
        return f"With {at}, {seen}: {bound}, as asked for ({asked})."
    if found["num_failed_pairs"]:
        return f"{asked} cannot be promised by any value: still with {at}, {seen} ({bound})."
    needed, missing = summary["num_pairs_needed"], summary["num_pairs_missing"]
    few = f"{asked} takes {needed} pairs without a wrong acceptance; these are {found['num_pairs']}, {missing} too few"
    return f"Too few pairs: {few}. What they promise, with {at}: {bound}."


def percent(share: float | None, up: bool = False) -> str:
    """A share in [0, 1] with three digits; up: never rounded down, as a bound has to be."""
    if share is None:
        return "-"
    value = 100.0 * share
    if up and value > 0.0:
        unit = 10.0 ** (math.floor(math.log10(value)) - 2)
        value = math.ceil(value / unit - 1e-9) * unit
    return f"{value:.3g} %"
