"""Does the covariance of accepted poses tell how large their errors are? Shares within 2 sigma, set by set."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import chi2

from lib.evidence import Contact, Row
from svc_ros.core.config import CovarianceConfig
from svc_ros.core.scan import Array
from svc_ros.core.sight.observability import SurfaceContact

AXES = ("x", "y", "z", "roll", "pitch", "yaw")
GOAL = 0.95
_CANDIDATES = np.geomspace(1.0, 1e4, 161)


def covariance_of(contact: Contact, config: CovarianceConfig) -> Array:
    """The covariance (6, 6) that an accepted pose gets, from what was kept of its contact."""
    return SurfaceContact(contact.information, 1, contact.variance).covariance(config)


def measure(rows: Sequence[Row], config: CovarianceConfig) -> dict[str, Any] | None:
    """Shares of errors within 2 sigma: all six axes at once (chi-square, 95 %) and each alone; pairs weigh the same."""
    kept = [row for row in rows if row.contact is not None]
    if not kept:
        return None
    per_pair = Counter(row.pair for row in kept)
    weights = np.array([1.0 / per_pair[row.pair] for row in kept])
    weights /= weights.sum()
    error = np.array([row.contact.error for row in kept if row.contact])
    covariance = np.array([covariance_of(row.contact, config) for row in kept if row.contact])
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    sigma = np.sqrt(np.einsum("nii->ni", covariance))
    within = np.abs(error) <= 2.0 * sigma
    return {
        "num_poses": len(kept),
        "num_pairs": len(per_pair),
        "within_2_sigma": float(weights @ (squared <= chi2.ppf(GOAL, 6))),
        "within_2_sigma_by_axis": dict(zip(AXES, (weights @ within).tolist(), strict=True)),
        "median_error": dict(zip(AXES, np.median(np.abs(error), 0).tolist(), strict=True)),
        "median_sigma": dict(zip(AXES, np.median(sigma, 0).tolist(), strict=True)),
        "median_mahalanobis": float(np.median(np.sqrt(squared))),
    }


def fit_points_per_constraint(rows: Sequence[Row], config: CovarianceConfig, axis_wise: bool = False) -> float | None:
    """The smallest tried value with which the goal is met; None where none reaches it."""
    for value in _CANDIDATES:
        measured = measure(rows, dataclasses.replace(config, points_per_constraint=float(value)))
        if measured is None:
            return None
        share = measured["within_2_sigma"]
        if axis_wise:
            share = float(np.mean(list(measured["within_2_sigma_by_axis"].values())))
        if share >= GOAL:
            return float(value)
    return None
