"""What a demanded probability promises: wrong acceptances over pairs, with an exact bound; how true probabilities are.

Poses of one pair are judged on the same scans, so they are no independent trials: a pair is one trial, and has failed
if any of its wrong poses is accepted. The more probability is demanded, the fewer fail; that is why the bound of a
value that was chosen on the same data holds like that of one chosen beforehand.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from svc_ros.core.errors import InputError
from svc_ros.core.scan import Array

LOWEST = 0.5  # of decision.min_probability: all that is accepted has at least this
_DIGITS = 4  # of a chosen probability
_GRID = np.round(np.append(np.arange(LOWEST, 0.9999, 0.005), [0.999, 0.9999]), _DIGITS)


@dataclass(frozen=True)
class JudgedPose:
    """One pose and the answer to it, judged with `decision.min_probability` at its lowest.

    pair: the same for both directions of a pair; kind: how the pose was made (`register`: found); correct: within the
    success thresholds, as it came out of the refinement; probability: None where there was no pose to judge;
    rotation_error_deg, translation_error_m: None without a reference.
    """

    dataset: str
    pair: str
    kind: str
    correct: bool
    accepted: bool
    probability: float | None
    rotation_error_deg: float | None = None
    translation_error_m: float | None = None

    @property
    def score(self) -> float:
        """Up to this demanded probability it is accepted; 0 where it is not accepted at any."""
        return self.probability if self.accepted and self.probability is not None else 0.0


@dataclass(frozen=True)
class Claim:
    """What `min_probability` promises: num_failed of num_pairs have an accepted wrong pose; bound: of their rate."""

    min_probability: float
    num_pairs: int
    num_failed: int
    bound: float


def binomial_upper_bound(failures: int, trials: int, confidence: float = 0.95) -> float:
    """Exact (Clopper-Pearson) one-sided upper bound of a failure rate; 1 without trials."""
    from scipy.stats import beta

    _check_share(confidence, "confidence")
    if not 0 <= failures <= trials:
        raise InputError(f"failures: expected 0 to {trials} (all trials), found {failures}")
    if failures == trials:
        return 1.0
    if failures == 0:
        return float(-math.expm1(math.log1p(-confidence) / trials))
    return float(beta.ppf(confidence, failures + 1, trials - failures))


def pairs_needed(rate: float, confidence: float = 0.95) -> int:
    """How many pairs without any failure promise that at most this share fails: 299 for 1 % at 95 %."""
    _check_share(rate, "rate")
    _check_share(confidence, "confidence")
    return math.ceil(math.log1p(-confidence) / math.log1p(-rate) - 1e-9)


def pair_scores(poses: Iterable[JudgedPose]) -> dict[tuple[str, str], float]:
    """The largest score of the wrong poses of each pair, by data set and pair: what has to be demanded, and a bit more.

    Pairs of which only right poses were judged had nothing to fail by and are left out.
    """
    worst: dict[tuple[str, str], float] = {}
    for pose in poses:
        if not pose.correct:
            key = (pose.dataset, pose.pair)
            worst[key] = max(worst.get(key, 0.0), pose.score)
    return worst


def claim_at(min_probability: float, scores: ArrayLike, confidence: float = 0.95) -> Claim:
    """What a demanded probability promises on pairs with these scores (N,), see `pair_scores`."""
    values = np.asarray(list(np.ravel(scores)), np.float64)
    num_failed = int((values >= min_probability).sum())
    bound = binomial_upper_bound(num_failed, len(values), confidence)
    return Claim(min_probability, len(values), num_failed, bound)


def choose_claim(scores: ArrayLike, max_rate: float, confidence: float = 0.95) -> Claim | None:
    """The smallest demanded probability whose bound is at most `max_rate`; None where none is."""
    _check_share(max_rate, "rate")
    claims = (claim_at(p, scores, confidence) for p in _borders(scores))
    return next((claim for claim in claims if claim.bound <= max_rate), None)


def surest_claim(scores: ArrayLike, confidence: float = 0.95) -> Claim:
    """The smallest bound that these pairs can promise, with the smallest demanded probability that has it."""
    return min((claim_at(p, scores, confidence) for p in _borders(scores)), key=lambda claim: claim.bound)


def curve(poses: Sequence[JudgedPose], confidence: float, extra: Iterable[float] = ()) -> dict[str, list[Any]]:
    """What every demanded probability of a grid, and each of `extra`, does: one list an entry."""
    scores = list(pair_scores(poses).values())
    right, wrong = (np.array([p.score for p in poses if p.correct is kind]) for kind in (True, False))
    grid = sorted({*_GRID.tolist(), *extra})
    claims = [claim_at(p, scores, confidence) for p in grid]
    return {
        "min_probability": grid,
        "num_failed_pairs": [claim.num_failed for claim in claims],
        "failed_rate": [claim.num_failed / claim.num_pairs if claim.num_pairs else None for claim in claims],
        "bound": [claim.bound for claim in claims],
        "num_wrong_accepted": [int((wrong >= p).sum()) for p in grid],
        "right_accepted_share": [float((right >= p).mean()) if len(right) else None for p in grid],
    }


def reliability_bins(probability: ArrayLike, correct: ArrayLike, num_bins: int = 10) -> list[dict[str, Any]]:
    """Of every tenth of the probabilities (N,), or another share: how many, their mean, and how many are correct (N,).

    A bin holds its lower edge, the last one its upper too; means of an empty bin are None.
    """
    p, y, idx = _binned(probability, correct, num_bins)
    rows: list[dict[str, Any]] = []
    for k in range(num_bins):
        inside = idx == k
        num = int(inside.sum())
        means = [float(values[inside].mean()) if num else None for values in (p, y)]
        row = {"low": k / num_bins, "high": (k + 1) / num_bins, "num": num}
        rows.append(row | {"mean_probability": means[0], "right_share": means[1]})
    return rows


def expected_calibration_error(probability: ArrayLike, correct: ArrayLike, num_bins: int = 10) -> float | None:
    """Mean distance [0, 1] of probability (N,) and share of correct (N,) in bins, weighed by size; None if empty."""
    rows = [row for row in reliability_bins(probability, correct, num_bins) if row["num"]]
    total = sum(row["num"] for row in rows)
    gaps = (row["num"] * abs(row["mean_probability"] - row["right_share"]) for row in rows)
    return sum(gaps) / total if total else None


def _borders(scores: ArrayLike) -> list[float]:
    """Demanded probabilities at which something changes: the lowest, and just above each score; all below 1."""
    values = np.asarray(list(np.ravel(scores)), np.float64)
    unit = 10**_DIGITS
    above = (np.floor(values[values >= LOWEST] * unit + 1e-9).astype(int) + 1) / unit
    return [LOWEST, *(p for p in np.unique(above).tolist() if p < 1.0)]


def _binned(probability: ArrayLike, correct: ArrayLike, num_bins: int) -> tuple[Array, Array, NDArray[np.int64]]:
    p, y = np.asarray(probability, np.float64), np.asarray(correct, bool)
    if num_bins < 1:
        raise InputError(f"bins: expected at least 1, found {num_bins}")
    if p.ndim != 1 or p.shape != y.shape:
        raise InputError(f"probabilities and labels: expected two lists of one length, found {p.shape} and {y.shape}")
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise InputError("probabilities: expected numbers in [0, 1], found others")
    idx = np.minimum((p * num_bins + 1e-12).astype(np.int64), num_bins - 1)
    return p, y.astype(np.float64), idx


def _check_share(value: float, name: str) -> None:
    if not 0.0 < value < 1.0:
        raise InputError(f"{name}: expected a number between 0 and 1, found {value:g}")
