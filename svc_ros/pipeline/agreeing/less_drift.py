"""How little drift may be assumed: the less, the better wrong loops are told from right ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

from svc_ros.core.config import Config

Found = TypeVar("Found")
_SHARES = (0.1, 0.3, 1.0)  # of the drift that is possible: most odometry is better, and so are the poses of a map
_LEAST = 1e-4  # what configurations allow
_AS_WELL, _MANY = 0.7, 4.0  # of the weight of the loops that agree; with fewer than so many nobody knows


def with_less_drift(config: Config) -> list[Config]:
    """The configuration with shares of the drift that it allows, the smallest first and all of it last."""
    limits = config.agreement
    return [
        dataclasses.replace(
            config,
            agreement=dataclasses.replace(
                limits, drift_ratio=max(share * limits.drift_ratio, _LEAST),
                drift_deg_per_metre=max(share * limits.drift_deg_per_metre, _LEAST),
            ),
        )
        for share in _SHARES
    ]  # fmt: skip


def least_that_does(found: Sequence[Found], weights: Sequence[float], most: float) -> Found:
    """What was found with the least drift with which loops agree about as well as they can.

    found: in the order of `with_less_drift`; weights: of the loops that agree, each; most: what they can
    weigh.
    """
    if most < _MANY:
        return found[-1]
    return next((each for each, weight in zip(found, weights, strict=True) if weight >= _AS_WELL * most), found[-1])
