"""How well is a pose judged? svc, its ablations and other rules on the labelled poses of every data set.

    python benchmarks/decision.py [--data DIR] [--out DIR] [--rows FILE]

Also the script that the borders of `DecisionConfig` come from: it prints what every border separates in every set and
fits them with one set left out at a time; and the check of the covariance against the references. Writes decision.json
and risk-coverage.png.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import _borders
import _rules
import _spread_of_errors
import numpy as np
from _common import (
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
from _evidence import Row, check_against_verify, gather

from svc_ros.evaluation.metrics import LabelledDecision, decision_metrics, roc_auc

ALL = "all sets"
COLUMNS = ("precision", "recall", "f1", "num_false_accepted", "roc_auc", "recall_at_precision_99")
HEAD = ("rule", "precision", "recall", "F1", "false accepts", "AUC", "recall at precision 0.99")
IN_PICTURE = (
    "svc", "svc, not refined", "svc, no sight lines", "svc_paper", "overlap 0.3", "logistic, no sight lines",
    "logistic, sight lines",
)  # fmt: skip
Answers = dict[str, list[_rules.Answer]]


def main() -> None:
    """Gather, compare, fit, check, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--rows", type=Path, help="measured poses: read if the file exists, written otherwise")

    options = parse_options("Compare decision rules on labelled poses.", extend)
    datasets = [d for d in read_datasets(options.data) if d.candidates]
    configs = {d.name: config_of(d) for d in datasets}
    rows, run = collect(datasets, options.workers, options.rows)
    answers = answer_all(rows, configs)
    borders = compare_borders(rows, configs)
    answers["svc, borders of the other sets"] = borders.pop("answers")
    tables = tabulate(rows, answers)
    for name, table in tables.items():
        print_table(name, HEAD, [(rule, *(values[c] for c in COLUMNS)) for rule, values in table.items()])
    same, different = check_against_verify(rows, dict(enumerate(answers[_rules.SVC])))
    console.print(f"verify() itself, asked about {same + different} of {len(rows)} poses, differs on {different}.")
    print_borders(borders)
    covariance = check_covariance(rows, answers[_rules.SVC], configs)
    draw_risk_coverage(rows, answers, options.out / "risk-coverage.png")
    values = {
        "num_poses": {name: sum(row.dataset == name for row in rows) for name in configs},
        "verify_sample": {"same": same, "different": different},
        "decision": tables, "borders": borders, "covariance": covariance,
    }  # fmt: skip
    write_report(options.out / "decision.json", values, run)


def collect(datasets: Sequence[Dataset], workers: int, kept: Path | None) -> tuple[list[Row], dict[str, Any]]:
    """Measure every labelled pose, or read what was measured before; with the run that measured them."""
    if kept is not None and kept.exists():
        rows, run = pickle.loads(kept.read_bytes())
        return rows, run
    run = describe_run(datasets)
    jobs = [(dataset, pair, k) for dataset in datasets for k, pair in enumerate(dataset.candidates)]
    rows = [row for of_pair in spread(gather, jobs, workers, "labelled poses") for row in of_pair]
    if kept is not None:
        kept.write_bytes(pickle.dumps((rows, run)))
    return rows, run


def answer_all(rows: Sequence[Row], configs: _rules.Configs) -> Answers:
    """The answers of every rule to every row."""
    answers = {
        name: [_rules.answer_variant(row, configs[row.dataset], variant) for row in rows]
        for name, variant in _rules.VARIANTS.items()
    }
    answers["svc_paper"] = [_rules.answer_paper(row) for row in rows]
    answers["overlap 0.3"] = [_rules.answer_overlap(row) for row in rows]
    answers["logistic, no sight lines"] = _rules.answer_logistic(rows, configs, _rules.features_without_sight_lines)
    answers["logistic, sight lines"] = _rules.answer_logistic(rows, configs, _rules.features_with_sight_lines)
    return answers


def tabulate(rows: Sequence[Row], answers: Answers) -> dict[str, dict[str, dict[str, Any]]]:
    """Metrics by set and rule, and of all sets together."""
    names = list(dict.fromkeys(row.dataset for row in rows))
    return {
        name: {rule: summarise(rows, given, None if name == ALL else name) for rule, given in answers.items()}
        for name in [*names, ALL]
    }


def summarise(rows: Sequence[Row], given: Sequence[_rules.Answer], dataset: str | None) -> dict[str, Any]:
    """Metrics of one rule on one set (None: on all)."""
    decisions = [
        LabelledDecision(accepted, row.correct, score, row.origin)
        for row, (accepted, score) in zip(rows, given, strict=True)
        if dataset in (None, row.dataset)
    ]
    false_accepts = sum(d.accepted and not d.correct for d in decisions)
    return {**decision_metrics(decisions), "num_false_accepted": false_accepts}


def compare_borders(rows: Sequence[Row], configs: _rules.Configs) -> dict[str, Any]:
    """What the borders separate, their fit to all sets, and to all but one, tested on that one."""
    names = list(dict.fromkeys(row.dataset for row in rows))
    fitted_rows = _borders.judged(rows, configs)
    worst_right = _borders.find_worst_right(fitted_rows)
    gaps = {
        name: _borders.measure_gaps([r for r in fitted_rows if r.dataset == name], worst_right) for name in names
    }  # fmt: skip
    gaps[ALL] = _borders.measure_gaps(fitted_rows, worst_right)
    left_out = {}
    answers: list[_rules.Answer] = [(False, 0.0)] * len(rows)
    for name in names:
        borders = _borders.fit_borders([r for r in fitted_rows if r.dataset != name])
        tested = [k for k, row in enumerate(rows) if row.dataset == name]
        variant = _rules.Variant(borders=borders)
        for k in tested:
            answers[k] = _rules.answer_variant(rows[k], configs[name], variant)
        margins = [_rules.smallest_margin(rows[k], configs[name], borders) for k in tested]
        auc = roc_auc(margins, [rows[k].correct for k in tested])
        left_out[name] = {"borders": borders, "margin_auc": auc, **summarise(rows, answers, name)}
    configured = {b.name: getattr(next(iter(configs.values())).decision, b.name) for b in _borders.BORDERS}
    return {
        "configured": configured, "fitted_to_all": _borders.fit_borders(fitted_rows), "gaps": gaps,
        "leave_one_set_out": left_out, "answers": answers,
    }  # fmt: skip


def print_borders(borders: Mapping[str, Any]) -> None:
    """What every border separates, then the fits."""
    rows = [
        (f"{border.name}: {name}", gap[border.name].right, gap[border.name].wrong, gap[border.name].num_wrong)
        for border in _borders.BORDERS
        for name, gap in borders["gaps"].items()
    ]
    head = ("border: set", "worst right pose", "best wrong pose it has to stop", "wrong poses it has to stop")
    print_table("What the borders separate, refined (each wrong pose counts where it is farthest out)", head, rows)
    names = [border.name for border in _borders.BORDERS]
    fits = [
        ("configured", *(borders["configured"][n] for n in names), None, None, None),
        ("fitted to all sets", *(borders["fitted_to_all"][n] for n in names), None, None, None),
    ]
    tests = ("margin_auc", "f1", "num_false_accepted")
    fits += [
        (f"without {name}", *(fit["borders"][n] for n in names), *(fit[t] for t in tests))
        for name, fit in borders["leave_one_set_out"].items()
    ]
    short = [name.replace("_per_overlap", " / overlap").replace("_", " ") for name in names]
    head = ("fit", *short, "AUC of the margin", "F1", "false accepts")
    print_table("Borders fitted without a set, tested on it", head, fits)


def check_covariance(
    rows: Sequence[Row], given: Sequence[_rules.Answer], configs: _rules.Configs
) -> dict[str, dict[str, Any]]:
    """Shares of the errors of accepted right poses within 2 sigma, and what would bring them to 95 %."""
    report, table = {}, []
    for name, config in configs.items():
        accepted = [r for r, (ok, _) in zip(rows, given, strict=True) if ok and r.correct and r.dataset == name]
        measured = _spread_of_errors.measure(accepted, config.covariance)
        if measured is None:
            continue
        wanted = _spread_of_errors.fit_points_per_constraint(accepted, config.covariance)
        wanted_by_axis = _spread_of_errors.fit_points_per_constraint(accepted, config.covariance, axis_wise=True)
        used = config.covariance.points_per_constraint
        report[name] = {
            **measured, "points_per_constraint": used, "points_per_constraint_for_95": wanted,
            "points_per_constraint_for_95_by_axis": wanted_by_axis,
        }  # fmt: skip
        by_axis = measured["within_2_sigma_by_axis"].values()
        table.append(
            (
                name,
                measured["num_pairs"],
                measured["within_2_sigma"],
                *by_axis,
                used,
                *map(_at_least, (wanted, wanted_by_axis)),
            )
        )
    head = ("set", "pairs", "all six", *_spread_of_errors.AXES, "points per constraint", "for 95 %", "axis by axis")
    title = "Errors of accepted right poses within 2 sigma (the references themselves are 1-10 cm off)"
    print_table(title, head, table)
    return report


def _at_least(value: float | None) -> str | None:
    return None if value is None else "<= 1" if value <= 1.0 else f"{value:.0f}"


def draw_risk_coverage(rows: Sequence[Row], answers: Answers, path: Path) -> None:
    """Wrong poses among the accepted over the share of right poses accepted, as the threshold on the score falls."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
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
    figure.savefig(path, dpi=130)
    console.print(f"wrote {path}")


def risk_curve(scores: np.ndarray, correct: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coverage and risk at every threshold that parts the scores; equal scores are accepted together."""
    order = np.argsort(-scores, kind="stable")
    last = np.append(np.diff(scores[order]) != 0, True)
    right = np.cumsum(correct[order])[last]
    return right / correct.sum(), 1.0 - right / (np.flatnonzero(last) + 1)


if __name__ == "__main__":
    main()
