"""How well is a pose judged? svc, its ablations and other rules on the labelled poses of every data set.

    python benchmarks/decision.py [--data DIR] [--out DIR] [--rows FILE] [--no-simulated]

Also the script that the weights of `DecisionConfig` come from: it fits them to recorded and simulated sets, and again
with one sensor left out at a time, and tells whether the probabilities of the left-out answers come true; and the check
of the covariance against the references. Writes decision.json, risk-coverage.png and reliability.png.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import numpy as np
from lib import calibration as _calibration
from lib import rules as _rules
from lib import sensors as _sensors
from lib import simulated as _simulated
from lib import simulated_halls, simulated_sensors, spread_of_errors
from lib import weights as _weights
from lib.common import (
    Dataset,
    config_of,
    console,
    describe_run,
    parse_options,
    print_table,
    read_datasets,
    spread,
    write_report,
)
from lib.evidence import Row, check_against_verify, gather
from lib.figures import new_figure, write_figure

from svc_ros.core.config import preset
from svc_ros.evaluation.metrics import LabelledDecision, decision_metrics

RECORDED, ALL = "recorded sets", "all sets"
COLUMNS = ("precision", "recall", "f1", "num_false_accepted", "roc_auc", "recall_at_precision_99")
HEAD = ("rule", "precision", "recall", "F1", "false accepts", "AUC", "recall at precision 0.99")
OTHERS = "svc, weights of the other sensors"
IN_PICTURE = (
    "svc", OTHERS, "svc, not refined", "svc, nothing denied", "denied share alone", "svc_paper", "overlap 0.3",
    "logistic, no sight lines", "logistic, sight lines",
)  # fmt: skip
SIMULATED = {"traffic and rooms": _simulated, "simulated sensors": simulated_sensors, "halls": simulated_halls}
Answers = dict[str, list[_rules.Answer]]


def main() -> None:
    """Gather, compare, fit, check, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--rows", type=Path, help="measured poses: read if the file exists, written otherwise")
        parser.add_argument("--no-simulated", action="store_true", help="leave the simulated sets out")

    options = parse_options("Compare decision rules on labelled poses.", extend)
    datasets = [d for d in read_datasets(options.data) if d.candidates]
    given = {} if options.no_simulated else _simulated.PRESETS | simulated_sensors.PRESETS | simulated_halls.PRESETS
    simulated = {name: preset(of_group) for name, of_group in given.items()}
    configs = {d.name: config_of(d) for d in datasets} | simulated
    rows, run = collect(datasets, options, bool(simulated))
    rows = [row for row in rows if row.dataset in configs]
    answers = answer_all(rows, configs)
    tables = tabulate(rows, answers)
    for name, table in tables.items():
        print_table(name, HEAD, [(rule, *(values[c] for c in COLUMNS)) for rule, values in table.items()])
    same, different = check_against_verify(rows, dict(enumerate(answers[_rules.SVC])))
    console.print(f"verify() itself, asked about {same + different} of {len(rows)} poses, differs on {different}.")
    weights = _weights.compare_weights(rows, configs)
    print_weights(weights, {name: tables[name][OTHERS] for name in _sensors.sensors_of(rows)})
    calibration = _calibration.measure(rows, answers[OTHERS])
    _calibration.show(calibration)
    _calibration.draw(calibration, options.out / "reliability.png")
    covariance = check_covariance(rows, answers[_rules.SVC], configs)
    draw_risk_coverage(rows, answers, options.out / "risk-coverage.png")
    values = {
        "num_poses": {name: sum(row.dataset == name for row in rows) for name in configs},
        "verify_sample": {"same": same, "different": different},
        "decision": tables, "weights": weights, "calibration": calibration, "covariance": covariance,
    }  # fmt: skip
    write_report(options.out / "decision.json", values, run)


def collect(
    datasets: Sequence[Dataset], options: argparse.Namespace, simulate: bool
) -> tuple[list[Row], dict[str, Any]]:
    """Measure every labelled pose, or read what was measured before; with the run that measured them."""
    kept: Path | None = options.rows
    if kept is not None and kept.exists():
        rows, run = pickle.loads(kept.read_bytes())
        return rows, run
    run = describe_run(datasets)
    jobs = [(dataset, pair, k) for dataset in datasets for k, pair in enumerate(dataset.candidates)]
    rows = [row for of_pair in spread(gather, jobs, options.workers, "labelled poses") for row in of_pair]
    for name, group in SIMULATED.items() if simulate else ():
        places = [(place, k) for k, place in enumerate(group.places())]
        measured = spread(group.gather_simulated, places, options.workers, name)
        rows += [row for at_place in measured for row in at_place]
    if kept is not None:
        kept.write_bytes(pickle.dumps((rows, run)))
    return rows, run


def answer_all(rows: Sequence[Row], configs: _rules.Configs) -> Answers:
    """The answers of every rule to every row."""
    answers = {
        name: [_rules.answer_variant(row, configs[row.dataset], variant) for row in rows]
        for name, variant in _rules.VARIANTS.items()
    }
    answers[OTHERS] = _weights.answer_left_out(rows, configs)
    for weight in _weights.WEIGHTS:
        answers[f"{OTHERS}, no {weight.removesuffix('_weight')}"] = _weights.answer_left_out(rows, configs, weight)
    answers["svc_paper"] = [_rules.answer_paper(row) for row in rows]
    answers["denied share alone"] = [_rules.answer_denied_share(row, configs[row.dataset]) for row in rows]
    answers["overlap 0.3"] = [_rules.answer_overlap(row) for row in rows]
    answers["logistic, no sight lines"] = _rules.answer_logistic(rows, configs, _rules.features_without_sight_lines)
    answers["logistic, sight lines"] = _rules.answer_logistic(rows, configs, _rules.features_with_sight_lines)
    return answers


def tabulate(rows: Sequence[Row], answers: Answers) -> dict[str, dict[str, dict[str, Any]]]:
    """Metrics by rule: of every set, of every sensor, of all recorded sets together, and of all sets."""
    names = list(dict.fromkeys(row.dataset for row in rows))
    recorded = {name for name in names if not name.startswith("simulated")}
    groups = {name: {name} for name in names} | {RECORDED: recorded, ALL: set(names)}
    for sensor in _sensors.sensors_of(rows):
        groups[sensor] = {name for name in names if _sensors.sensor_of(name) == sensor}
    return {
        group: {rule: summarise(rows, given, members) for rule, given in answers.items()}
        for group, members in groups.items()
    }


def summarise(rows: Sequence[Row], given: Sequence[_rules.Answer], datasets: Set[str]) -> dict[str, Any]:
    """Metrics of one rule on the sets of these names."""
    decisions = [
        LabelledDecision(accepted, row.correct, score, row.origin)
        for row, (accepted, score) in zip(rows, given, strict=True)
        if row.dataset in datasets
    ]
    false_accepts = sum(d.accepted and not d.correct for d in decisions)
    return {**decision_metrics(decisions), "num_false_accepted": false_accepts}


def print_weights(weights: Mapping[str, Any], tested: Mapping[str, Mapping[str, Any]]) -> None:
    """The weights as configured and as fitted, then the fits without a sensor and their test on it (`tested`)."""
    judged = ("margin_auc", "smallest_right_margin", "largest_wrong_margin")
    counted = ("f1", "num_false_accepted")
    fits = [
        (title, *(weights[key][name] for name in _weights.FIELDS), *[None] * (len(judged) + len(counted)))
        for title, key in (("configured", "configured"), ("fitted to all sets", "fitted_to_all"))
    ]
    fits += [
        (f"without {name}", *(fit["weights"][field] for field in _weights.FIELDS), *(fit[key] for key in judged),
         *(tested[name][key] for key in counted))
        for name, fit in weights["leave_one_sensor_out"].items()
    ]  # fmt: skip
    head = (
        "fit", *(name.removesuffix("_weight") for name in _weights.FIELDS),
        "AUC", "least right", "most wrong", "F1", "false accepts",
    )  # fmt: skip
    print_table("Weights fitted without a sensor, tested on it (AUC and extremes of the smallest margin)", head, fits)


def check_covariance(
    rows: Sequence[Row], given: Sequence[_rules.Answer], configs: _rules.Configs
) -> dict[str, dict[str, Any]]:
    """Shares of the errors of accepted right poses within 2 sigma, and what would bring them to 95 %."""
    report, table = {}, []
    for name, config in configs.items():
        accepted = [r for r, (ok, _) in zip(rows, given, strict=True) if ok and r.correct and r.dataset == name]
        measured = spread_of_errors.measure(accepted, config.covariance)
        if measured is None:
            continue
        wanted = spread_of_errors.fit_points_per_constraint(accepted, config.covariance)
        wanted_by_axis = spread_of_errors.fit_points_per_constraint(accepted, config.covariance, axis_wise=True)
        used = config.covariance.points_per_constraint
        report[name] = {
            **measured, "points_per_constraint": used, "points_per_constraint_for_95": wanted,
            "points_per_constraint_for_95_by_axis": wanted_by_axis,
        }  # fmt: skip
        by_axis = measured["within_2_sigma_by_axis"].values()
        shares = (measured["within_2_sigma"], *by_axis)
        table.append((name, measured["num_pairs"], *shares, used, *map(_at_least, (wanted, wanted_by_axis))))
    head = ("set", "pairs", "all six", *spread_of_errors.AXES, "points per constraint", "for 95 %", "axis by axis")
    title = "Errors of accepted right poses within 2 sigma (the references themselves are 1-10 cm off)"
    print_table(title, head, table)
    return report


def _at_least(value: float | None) -> str | None:
    return None if value is None else "<= 1" if value <= 1.0 else f"{value:.0f}"


def draw_risk_coverage(rows: Sequence[Row], answers: Answers, path: Path) -> None:
    """Wrong poses among the accepted over the share of right poses accepted, as the threshold on the score falls."""
    figure = new_figure(8.0, 5.0)
    axes = figure.add_subplot()
    correct = np.array([row.correct for row in rows])
    for rule in IN_PICTURE:
        coverage, risk = risk_curve(np.array([score for _, score in answers[rule]]), correct)
        (line,) = axes.plot(coverage, risk, label=rule, linewidth=2.4 if rule == _rules.SVC else 1.3)
        accepted = np.array([ok for ok, _ in answers[rule]])
        if accepted.any():
            axes.plot((accepted & correct).sum() / correct.sum(), (accepted & ~correct).sum() / accepted.sum(), "o",
                      color=line.get_color(), markersize=5)  # fmt: skip
    axes.set(xlim=(0.0, 1.01), ylim=(-0.01, 0.5), title="All sets; dots: the rule's own threshold")
    axes.set(xlabel="share of right poses accepted", ylabel="share of wrong poses among the accepted")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize=8, frameon=False)
    write_figure(figure, path)


def risk_curve(scores: np.ndarray, correct: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coverage and risk at every threshold that parts the scores; equal scores are accepted together."""
    order = np.argsort(-scores, kind="stable")
    last = np.append(np.diff(scores[order]) != 0, True)
    right = np.cumsum(correct[order])[last]
    return right / correct.sum(), 1.0 - right / (np.flatnonzero(last) + 1)


if __name__ == "__main__":
    main()
