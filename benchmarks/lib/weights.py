"""Where the weights of `DecisionConfig` come from: logistic regression over what is denied of a pose in contact."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from lib import simulated_halls
from lib.evidence import Row, evidence_of
from lib.rules import Answer, Configs, Variant, answer_variant, fit_logistic, is_moved, smallest_margin
from lib.sensors import sensor_of, sensors_of, weigh_groups
from svc_ros.core import decision
from svc_ros.evaluation.metrics import roc_auc

OFFSET = "offset"
WEIGHTS = ("denied_weight", "wide_denied_weight", "structure_weight")
FIELDS = (OFFSET, *WEIGHTS)
_SIGNS = np.array([-1.0, -1.0, 1.0])  # what is denied speaks against a pose, structure for it
Weights = dict[str, float]


def in_contact(rows: Sequence[Row], configs: Configs) -> list[Row]:
    """Rows that the weights have to tell apart: enough surface agrees, and refinement left the pose where it was.

    Half turns in halls look as right as a pose can; they are told by holding both against each other, not by weights.
    """
    return [
        row for row in rows
        if row.dataset not in simulated_halls.PRESETS
        and not is_moved(row, configs[row.dataset])
        and row.seen["refined"]["oriented_overlap_ratio"] >= configs[row.dataset].decision.min_oriented_overlap
        and row.seen["refined"]["constraint_ratio"] >= configs[row.dataset].decision.min_constraint
    ]  # fmt: skip


def fit_weights(rows: Sequence[Row], configs: Configs, without: str | None = None) -> Weights:
    """Values of the FIELDS, rounded as they are configured; the weight named `without` is 0, its number unseen.

    Every sensor and label weighs the same, however many poses it has. Raises ValueError where no right or no wrong pose
    is in contact.
    """
    rows = in_contact(rows, configs)
    correct = np.array([row.correct for row in rows], bool)
    if correct.all() or not correct.any():
        found = f"{correct.sum()} right of {len(rows)}"
        raise ValueError(f"weights: expected right and wrong poses in contact, found {found}")
    used = [k for k, name in enumerate(WEIGHTS) if name != without]
    numbers = np.array([decision.describe(evidence_of(row.seen["refined"])) for row in rows]) * _SIGNS
    model = fit_logistic(numbers[:, used], correct, weigh_groups(rows), never_negative=True)
    fitted = dict.fromkeys(FIELDS, 0.0)
    fitted |= {WEIGHTS[k]: round(float(weight), 2) for k, weight in zip(used, model.weights, strict=True)}
    return fitted | {OFFSET: round(model.offset, 2)}


def fit_without_each(rows: Sequence[Row], configs: Configs, without: str | None = None) -> dict[str, Weights]:
    """The weights for each sensor, fitted to all others."""
    return {
        name: fit_weights([row for row in rows if sensor_of(row.dataset) != name], configs, without)
        for name in sensors_of(rows)
    }


def answer_left_out(rows: Sequence[Row], configs: Configs, without: str | None = None) -> list[Answer]:
    """What svc answers to each row with the weights of the other sensors."""
    fitted = {name: Variant(borders=weights) for name, weights in fit_without_each(rows, configs, without).items()}
    return [answer_variant(row, configs[row.dataset], fitted[sensor_of(row.dataset)]) for row in rows]


def judge_margins(rows: Sequence[Row], configs: Configs, weights: Weights) -> dict[str, Any]:
    """How far the margin tells right from wrong poses with these weights, doubts left aside.

    Poses that refinement moves away rank below all others, and do not count as the smallest or the largest margin.
    """
    margins = np.array([smallest_margin(row, configs[row.dataset], weights) for row in rows])
    correct = np.array([row.correct for row in rows])
    stayed = np.array([not is_moved(row, configs[row.dataset]) for row in rows])
    return {
        "margin_auc": roc_auc(margins, correct),
        "smallest_right_margin": min(margins[correct & stayed].tolist(), default=None),
        "largest_wrong_margin": max(margins[~correct & stayed].tolist(), default=None),
    }


def configured_weights(configs: Configs) -> Weights:
    """The FIELDS as they are configured; all presets share them."""
    config = dataclasses.asdict(next(iter(configs.values())).decision)
    return {name: config[name] for name in FIELDS}


def compare_weights(rows: Sequence[Row], configs: Configs) -> dict[str, Any]:
    """Configured and fitted weights, and for each sensor those of all other sensors with their test on it."""
    configured, counted = configured_weights(configs), in_contact(rows, configs)
    tests, counts = {}, {}
    for name, weights in fit_without_each(rows, configs).items():
        tested = [row for row in rows if sensor_of(row.dataset) == name]
        tests[name] = {
            "weights": weights, **judge_margins(tested, configs, weights),
            "as_configured": judge_margins(tested, configs, configured),
        }  # fmt: skip
        counts[name] = [
            sum(sensor_of(r.dataset) == name and r.correct == label for r in counted) for label in (True, False)
        ]
    return {
        "configured": configured, "fitted_to_all": fit_weights(rows, configs),
        "num_right_and_wrong": counts, "leave_one_sensor_out": tests,
    }  # fmt: skip
