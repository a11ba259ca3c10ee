"""Do the probabilities of answers on sensors that were left out come true? Reliability and calibration error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lib.common import print_table
from lib.evidence import Row
from lib.figures import new_figure, write_figure
from lib.rules import Answer
from lib.sensors import sensor_of, sensors_of
from svc_ros.evaluation.calibration.claims import expected_calibration_error, reliability_bins

_BINS = 10
RECORDED, ALL = "recorded sets", "all sets"


def measure(rows: Sequence[Row], answers: Sequence[Answer]) -> dict[str, Any]:
    """Calibration error of the probabilities by sensor and over all, and the bins of the diagram."""
    probability = np.array([p for _, p in answers])
    correct = np.array([row.correct for row in rows])
    groups = {name: np.array([sensor_of(row.dataset) == name for row in rows]) for name in sensors_of(rows)}
    recorded = np.array([not row.dataset.startswith("simulated") for row in rows])
    groups |= {RECORDED: recorded, ALL: np.ones(len(rows), bool)}
    errors = {name: expected_calibration_error(probability[g], correct[g], _BINS) for name, g in groups.items()}
    bins = {name: reliability_bins(probability[groups[name]], correct[groups[name]], _BINS) for name in (RECORDED, ALL)}
    return {"expected_calibration_error": errors, "reliability": bins}


def show(calibration: Mapping[str, Any]) -> None:
    """The errors by sensor, and the bins over all."""
    errors = calibration["expected_calibration_error"]
    print_table("Expected calibration error of answers on left-out sensors", ("sensor", "error"), errors.items())
    rows = [
        (f"{b['low']:.1f} to {b['high']:.1f}", b["num"], b["mean_probability"], b["right_share"])
        for b in calibration["reliability"][ALL]
    ]
    print_table("Of such answers", ("probability", "answers", "mean probability", "right"), rows)


def draw(calibration: Mapping[str, Any], path: Path) -> None:
    """Reliability diagram: how many are right over what was said; numbers beside the dots are of answers."""
    figure = new_figure(5.6, 5.2)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    for name, bins in calibration["reliability"].items():
        held = [b for b in bins if b["num"]]
        x, y = [b["mean_probability"] for b in held], [b["right_share"] for b in held]
        error = calibration["expected_calibration_error"][name]
        axes.plot(x, y, "o-", markersize=5, label=f"{name}: calibration error {error:.3f}")
        if name == ALL:
            for b, at in zip(held, zip(x, y, strict=True), strict=True):
                axes.annotate(str(b["num"]), at, textcoords="offset points", xytext=(6, -10), fontsize=7)
    axes.set(xlabel="probability that was told", ylabel="share of right poses", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
    axes.set_title("Answers on sensors that were left out of the fit", fontsize=10)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    write_figure(figure, path)
