"""A calibration as one HTML file that needs nothing else: what a demanded probability accepts, and how true it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import svc_ros
from svc_ros.evaluation.calibration_summary import Row, percent, statement
from svc_ros.evaluation.report import write_page


def write_calibration_page(path: Path, summary: Row) -> None:
    """Write the page of what `calibrate` told. Raises InputError and MissingDependencyError as a report does."""
    names = ", ".join(one["dataset"] for one in summary["datasets"])
    told = ("curve", "reliability", "max_wrong_rate", "confidence", "present", "chosen", "surest", "wrong_accepted")
    page = {key: summary[key] for key in told} | {
        "title": f"Calibration on {names}",
        "version": svc_ros.__version__,
        "statement": statement(summary),
        "rows": calibration_rows(summary),
        "sets": set_rows(summary),
    }
    write_page(path, page, "calibration.html", ("calibration.js",))


def calibration_rows(summary: Row) -> list[list[str]]:
    """Names and values of the whole, as text, for tables."""
    other = summary["chosen"] or summary["surest"]
    name = "chosen" if summary["chosen"] else "best"
    rows: list[tuple[str, Any]] = [
        ("pairs", f"{summary['num_pairs']} ({summary['num_pairs_unusable']} more had too few points)"),
        ("right, wrong, grey poses", ", ".join(str(summary[f"num_{k}_poses"]) for k in ("right", "wrong", "grey"))),
        *_border_rows("present", summary["present"]),
        *_border_rows(name, other),
        ("pairs needed without a wrong acceptance", summary["num_pairs_needed"]),
        ("expected calibration error", _rounded(summary["expected_calibration_error"])),
        ("the same of accepted poses", _rounded(summary["expected_calibration_error_accepted"])),
    ]
    return [[key, str(value)] for key, value in rows]


def _border_rows(name: str, border: Row) -> list[tuple[str, Any]]:
    kinds = ", ".join(f"{kind} {num}" for kind, num in border["wrong_accepted_by_kind"].items())
    wrong = f"{border['num_failed_pairs']} (poses: {kinds})" if kinds else border["num_failed_pairs"]
    return [
        (f"{name} decision.min_probability", f"{border['min_probability']:g}"),
        (f"{name}: pairs with a wrong acceptance", wrong),
        (f"{name}: bound of their share", percent(border["wrong_rate_bound"], up=True)),
        (f"{name}: right poses accepted", percent(border["right_accepted_share"])),
    ]


def set_rows(summary: Row) -> list[list[str]]:
    """Data set, pairs, wrong and right acceptance at both borders."""
    rows = []
    for one in summary["datasets"]:
        borders = [one["present"], one["chosen" if summary["chosen"] else "surest"]]
        cells = [f"{b['num_failed_pairs']}, {percent(b['right_accepted_share'])}" for b in borders]
        rows.append([one["dataset"], str(one["num_pairs"]), *cells])
    return rows


def _rounded(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
