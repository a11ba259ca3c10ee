"""Numbers of the decision and of the covariance: part of the tree in config.py."""

from __future__ import annotations

from dataclasses import dataclass

from svc_ros.core.config_fields import Group, value


@dataclass(frozen=True)
class DecisionConfig(Group):
    """When a refined pose is accepted, rejected or left undecided; one set of borders for all sensors.

    benchmarks/decision.py fits the weights by logistic regression to right and wrong labelled poses of every real set
    and of simulated traffic and look-alike rooms, all weighing the same, and tests them on sets left out. The borders
    were chosen on the same poses and on simulated corridors; limits in benchmarks/README.md.
    """

    min_oriented_overlap: float = value(0.10, "less oriented overlap is too little to accept", "", 1e-3, 1.0)
    free_offset: float = value(-13.4, "log odds of a right pose: offset", "", -100.0, 100.0)
    blocked_weight: float = value(0.90, "and less this times the log of blocked share over overlap", "", 0.0, 100.0)
    scattered_weight: float = value(1.27, "the same outside the most blocked sectors", "", 0.0, 100.0)
    contradicted_weight: float = value(2.04, "the log of the blocked share of unmatched surface", "", 0.0, 100.0)
    tight_weight: float = value(2.15, "plus this times the log odds of agreement within tau / 4", "", 0.0, 100.0)
    max_blocked_per_overlap: float = value(0.09, "blocked share over overlap: beyond, rejected", "", 1e-3, 10.0)
    max_scattered_per_overlap: float = value(0.045, "the same outside the most blocked sectors", "", 1e-3, 10.0)
    max_opposed_per_overlap: float = value(0.60, "opposed share over oriented overlap", "", 1e-3, 10.0)
    max_free_blocked_per_overlap: float = value(0.15, "filled share of free space over oriented overlap", "", 1e-3, 10)
    min_free: int = value(100, "fewer directions in which nothing was met count for nothing", "", 1, 1_000_000)
    min_constraint: float = value(0.015, "less agreement across two directions is too little", "", 1e-4, 1.0)
    weak_constraint: float = value(0.13, "surfaces that resist a shift less than this call for more", "", 0.0, 1.0)
    max_blocked_where_weak: float = value(0.045, "then: blocked share over oriented overlap", "", 1e-3, 10.0)
    min_tight_where_weak: float = value(0.70, "then: share of agreeing points within tau / 4", "", 0.0, 0.99)
    min_probability: float = value(0.5, "a pose that is less probable is not accepted, but undecided", "", 0.5, 1.0)
    sharpness: float = value(2.0, "slope of the probability over the smallest margin", "", 0.1, 100.0)
    slip_m: float = value(2.4, "an accepted pose is shifted so far along its weak directions", "m", 0.01, 100.0)
    slip_score_ratio: float = value(0.68, "a slip scoring this share of the pose is as good", "", 0.0, 1.0)
    rival_score_ratio: float = value(0.92, "another refined pose scoring this share is as good", "", 0.0, 1.0)
    rival_strictness: float = value(1.9, "factor by which a rival must keep the blocked borders", "", 0.1, 10.0)


@dataclass(frozen=True)
class CovarianceConfig(Group):
    """Covariance of an accepted pose."""

    points_per_constraint: float = value(100.0, "neighbouring points that share one error", "", 1.0, 1e5)
    floor_translation_m: float = value(0.03, "smallest standard deviation of the translation", "m", 1e-4, 10.0)
    floor_rotation_deg: float = value(0.1, "smallest standard deviation of the rotation", "deg", 1e-4, 90.0)
