"""Which pairs of a set are registered, and descriptors that are computed once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lib.common import Dataset
from svc_ros.core.config import Config
from svc_ros.core.registration import extract_features
from svc_ros.core.scan import Features
from svc_ros.io.datasets import Pair

_MORE = {"os0_64_walk": 3}  # the set with the widest spread of overlap gets so many times the limit


def choose(dataset: Dataset, limit: int | None) -> list[Pair]:
    """At most `limit` pairs, evenly over the pairs in order of overlap, and as many negatives; all without a limit."""
    by_overlap = sorted(dataset.pairs, key=lambda pair: pair.overlap or 0.0)
    if limit is None:
        return [*by_overlap, *dataset.negatives]
    return evenly(by_overlap, limit * _MORE.get(dataset.name, 1)) + evenly(dataset.negatives, limit)


def evenly(pairs: Sequence[Pair], limit: int) -> list[Pair]:
    places = np.unique(np.linspace(0, len(pairs) - 1, min(limit, len(pairs))).round().astype(int))
    return [pairs[k] for k in places] if len(pairs) else []


_described: dict[tuple[Any, ...], Features] = {}


def describe(dataset: Dataset, path: str, config: Config) -> Features:
    """The scan's descriptors, kept for the next pair and for every method that shares these settings."""
    key = (dataset.name, path, config.preprocess, config.features)
    if key not in _described:
        if len(_described) > 40:
            _described.pop(next(iter(_described)))
        _described[key] = extract_features(dataset.read_scan(path), config)
    return _described[key]
