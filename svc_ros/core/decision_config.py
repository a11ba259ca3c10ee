"""Numbers of the decision and of the covariance: part of the tree in config.py."""

from __future__ import annotations

from dataclasses import dataclass

from svc_ros.core.config_fields import Group, value


@dataclass(frozen=True)
class DecisionConfig(Group):
    """When a refined pose is accepted, rejected or left undecided; one set of borders for all sensors.

    The four weights are fitted by logistic regression to right and wrong poses of every sensor, all weighing the same,
    and tested on sensors left out (benchmarks/decision.py).
    """

    offset: float = value(-1.56, "log odds of a right pose: offset", "", -100.0, 100.0)
    denied_weight: float = value(2.24, "less this times the log of the denied share", "", 0.0, 100.0)
    wide_denied_weight: float = value(1.59, "and of the same, clusters counting by their angle", "", 0.0, 100.0)
    structure_weight: float = value(5.84, "plus this times the log of how surfaces resist a shift", "", 0.0, 100.0)
    min_probability: float = value(0.5, "a pose that is less probable is not accepted, but undecided", "", 0.5, 1.0)
    min_oriented_overlap: float = value(0.08, "less oriented overlap is too little to accept", "", 1e-3, 1.0)
    min_constraint: float = value(0.01, "less agreement across two directions is too little", "", 1e-4, 1.0)
    max_opposed_per_overlap: float = value(0.80, "opposed share over oriented overlap", "", 1e-3, 10.0)
    max_free_blocked_per_overlap: float = value(0.15, "filled share of free space over oriented overlap", "", 1e-3, 10)
    min_free: int = value(100, "fewer directions in which nothing was met count for nothing", "", 1, 1_000_000)
    firm_structure: float = value(0.20, "of surfaces that hold a pose firmly: denied there is denied", "", 0, 1)
    weak_constraint: float = value(0.13, "along what resists less the pose is shifted, and doubted", "", 0.0, 1.0)
    slip_m: float = value(2.4, "so far, and half as far", "m", 0.01, 100.0)
    rival_odds: float = value(6.0, "a different pose less likely by no more than this factor is as good", "", 1.0, 1e6)


@dataclass(frozen=True)
class CovarianceConfig(Group):
    """Covariance of an accepted pose."""

    points_per_constraint: float = value(100.0, "neighbouring points that share one error", "", 1.0, 1e5)
    floor_translation_m: float = value(0.03, "smallest standard deviation of the translation", "m", 1e-4, 10.0)
    floor_rotation_deg: float = value(0.1, "smallest standard deviation of the rotation", "deg", 1e-4, 90.0)
