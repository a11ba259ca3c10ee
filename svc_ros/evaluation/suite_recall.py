"""Recall of a benchmark by each of its definitions: over all pairs, and as the mean over its scenes or sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from svc_ros.core.se3 import invert
from svc_ros.evaluation.summary import Row
from svc_ros.io.suites import Criterion, Suite, SuitePair


def information_rmse(T_estimate: ArrayLike, T_reference: ArrayLike, information: ArrayLike) -> float:
    """Root mean square displacement [m] of the reference's correspondences, as the benchmark approximates it.

    information: (6, 6) of gt.info, order x y z then the quaternion's x y z; its first entry counts the correspondences.
    """
    T, matrix = invert(T_reference) @ np.asarray(T_estimate, np.float64), np.asarray(information, np.float64)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    sign = -1.0 if w < 0.0 else 1.0
    error = np.concatenate([T[:3, 3], sign * np.array([x, y, z])])
    return float(np.sqrt(max(error @ matrix @ error / matrix[0, 0], 0.0)))


def summarise_recall(suite: Suite, pairs: Sequence[SuitePair], rows: Sequence[Row]) -> Row:
    """For each definition, by its name: recall of the best candidate whatever the verdict (the registration recall of
    papers), of accepted candidates alone, both over pairs and as the mean over groups, and each group's own numbers.

    rows: of the report, one a pair. A definition that no pair counts for has no numbers: None.
    """
    return {criterion.name: _summarise(criterion, pairs, rows) for criterion in suite.criteria}


def _summarise(criterion: Criterion, pairs: Sequence[SuitePair], rows: Sequence[Row]) -> Row:
    counted = [
        (pair.group, row)
        for pair, row in zip(pairs, rows, strict=True)
        if abs(pair.indices[0] - pair.indices[1]) >= criterion.min_gap
    ]
    groups = {
        name: _shares(criterion, [row for group, row in counted if group == name])
        for name in dict.fromkeys(group for group, _ in counted)
    }
    right = [row for _, row in counted if is_right(criterion, row)]
    return {
        **_shares(criterion, [row for _, row in counted]),
        "recall_mean_over_groups": _mean([group["recall"] for group in groups.values()]),
        "accepted_recall_mean_over_groups": _mean([group["accepted_recall"] for group in groups.values()]),
        "rotation_error_deg_mean": _mean([row["rotation_error_deg"] for row in right]),
        "translation_error_m_mean": _mean([row["translation_error_m"] for row in right]),
        "groups": groups,
    }


def is_right(criterion: Criterion, row: Mapping[str, Any]) -> bool:
    """Whether the best candidate of a row is right by this definition; a row without any is not."""
    if row["rotation_error_deg"] is None:
        return False
    if criterion.max_rmse_m is not None:
        return bool(row["rmse_m"] is not None and row["rmse_m"] <= criterion.max_rmse_m)
    rotation, translation = criterion.rotation_deg, criterion.translation_m
    return bool(
        (rotation is None or row["rotation_error_deg"] <= rotation)
        and (translation is None or row["translation_error_m"] <= translation)
    )


def _shares(criterion: Criterion, rows: Sequence[Row]) -> Row:
    right = [is_right(criterion, row) for row in rows]
    accepted = [ok and row["verdict"] == "accepted" for ok, row in zip(right, rows, strict=True)]
    return {
        "num_pairs": len(rows),
        "recall": _mean([float(ok) for ok in right]),
        "accepted_recall": _mean([float(ok) for ok in accepted]),
    }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None
