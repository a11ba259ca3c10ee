"""A calibration as one HTML file that needs nothing else: what a demanded probability accepts, and how true it is."""

from __future__ import annotations

from pathlib import Path

import svc_ros
from svc_ros.evaluation.calibration.summary import Row, percent, statement
from svc_ros.report.report import write_page


def write_calibration_page(path: Path, summary: Row) -> None:
    """Write the page of what `calibrate` told. Raises InputError and MissingDependencyError as a report does."""
    names = ", ".join(one["dataset"] for one in summary["datasets"])
    told = ("curve", "reliability", "max_wrong_rate", "confidence", "present", "chosen", "surest", "wrong_accepted")
    page = {key: summary[key] for key in told} | {
        "title": f"Calibration on {names}",
        "version": svc_ros.__version__,
        "statement": statement(summary),
        "borders": border_rows(summary),
        "counts": count_rows(summary),
    }
    write_page(path, page, "calibration.html", ("calibration.js",))


def border_rows(summary: Row) -> list[list[str]]:
    """The border in use beside the chosen one, else the best: a head and rows of text, data sets last."""
    name = "chosen" if summary["chosen"] else "surest"
    borders = [summary["present"], summary[name]]
    confidence = percent(summary["confidence"])
    rows = [
        ["", "present", "chosen" if summary["chosen"] else "best of these data"],
        ["decision.min_probability", *(f"{b['min_probability']:g}" for b in borders)],
        ["pairs with a wrong acceptance", *(f"{b['num_failed_pairs']} of {b['num_pairs']}" for b in borders)],
        [f"bound of their share, {confidence} confidence", *(percent(b["wrong_rate_bound"], up=True) for b in borders)],
        ["wrong poses accepted", *(_by_kind(b) for b in borders)],
        ["right poses accepted", *(percent(b["right_accepted_share"]) for b in borders)],
    ]
    for one in summary["datasets"] if len(summary["datasets"]) > 1 else ():
        here = [one["present"], one[name]]
        failed = (f"{b['num_failed_pairs']} of {one['num_pairs']}" for b in here)
        rows.append([f"{one['dataset']}: failed pairs", *failed])
        rows.append([f"{one['dataset']}: right accepted", *(percent(b["right_accepted_share"]) for b in here)])
    return rows


def count_rows(summary: Row) -> list[list[str]]:
    """What was judged, and how true the probabilities are: names and values as text."""
    registered = summary["register"]
    rows: list[list[str]] = [
        ["right, wrong, grey poses", ", ".join(str(summary[f"num_{k}_poses"]) for k in ("right", "wrong", "grey"))],
        ["scans", str(summary["num_scans"])],
        ["pairs with too few points", str(summary["num_pairs_unusable"])],
        ["pairs needed if none fails", str(summary["num_pairs_needed"])],
        ["expected calibration error", _rounded(summary["expected_calibration_error"])],
        ["the same of accepted poses", _rounded(summary["expected_calibration_error_accepted"])],
    ]
    if registered:
        found = f"{registered['num_registrations']}, right pose found in {registered['num_right']}"
        rows.insert(1, ["registrations, far apart ones too", found])
    return rows


def _by_kind(border: Row) -> str:
    kinds = border["wrong_accepted_by_kind"].items()
    return ", ".join(f"{kind} {num}" for kind, num in kinds) or "none"


def _rounded(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
