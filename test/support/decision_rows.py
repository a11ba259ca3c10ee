"""Toy rows of labelled poses for the tests of benchmarks/decision.py: known evidence, nothing measured."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from svc_ros.core.sight.evidence import SeenSurface, SightLines, SightViewEvidence

NUM_SEEN = 4000  # points of each scan that the other sensor could see


def surface(denied: float, wide: float | None = None) -> SeenSurface:
    """Surface of which that share is denied; `wide`: the same by clusters, the plain share if None."""
    num = round(denied * NUM_SEEN)
    wide_denied = num if wide is None else wide * (NUM_SEEN - num) / (1.0 - wide)
    return SeenSurface(NUM_SEEN + 900, NUM_SEEN - num, np.arange(num), wide_denied, 700, 200)


def evidence(
    denied: float, structure: float = 0.2, wide: float | None = None, overlap: float = 0.6, **changes: Any
) -> SightViewEvidence:
    """Evidence that is the same both ways: shares of denied surface, weakest constraint, overlap."""
    lines, seen = SightLines(5000, 1500, np.zeros(50), np.zeros(50), 700, 7), surface(denied, wide)
    found = SightViewEvidence(lines, lines, overlap, overlap, 0.01, 0.2, structure, 0.8, seen, seen)
    return dataclasses.replace(found, **changes)


def row(
    dataset: str, correct: bool, shown: SightViewEvidence, slips: Iterable[SightViewEvidence] = (),
    turns: Iterable[SightViewEvidence] = (), **changes: Any,
):  # fmt: skip
    """A row whose views all show the same."""
    from lib.evidence import VIEWS, Row

    views = dict.fromkeys(VIEWS, shown.numbers())
    others = [{view: [e.numbers() for e in given] for view in VIEWS} for given in (slips, turns)]
    made = Row(dataset, "pair", "toy", correct, (0.0, 0.0), views, *others, 0.5, not correct)
    return dataclasses.replace(made, **changes)


def toy_rows(names: Iterable[str], num: int = 30, seed: int = 0) -> list:
    """Sets in which right poses are denied little and held firmly, wrong ones denied much and held less; they overlap.

    What is wide tells the same a second time, with a noise of its own.
    """
    rng, rows = np.random.default_rng(seed), []
    for name in names:
        for correct in (True, False):
            for _ in range(num):
                denied, wide = np.exp(rng.normal(-4.5 if correct else -2.7, 0.5) + rng.normal(0.0, 0.3, 2))
                structure = np.exp(rng.normal(-1.9 if correct else -2.5, 0.3))
                rows.append(row(name, correct, evidence(denied, structure, wide)))
    return rows


def planted_rows(name: str, weights: Sequence[float], num: int = 3000, seed: int = 1) -> list:
    """Poses that are right with log odds of these weights (3,) of `decision.describe`, about half of them."""
    from svc_ros.core import decision

    rng = np.random.default_rng(seed)
    denied, wide = np.exp(rng.uniform(-5.0, -1.5, (2, num)))
    structure = np.exp(rng.uniform(-3.5, -1.2, num))
    seen = [evidence(*shares) for shares in zip(denied, structure, wide, strict=True)]
    odds = np.array([decision.describe(e) for e in seen]) @ weights
    right = rng.random(num) < 1.0 / (1.0 + np.exp(np.median(odds) - odds))
    return [row(name, bool(correct), e) for correct, e in zip(right, seen, strict=True)]
