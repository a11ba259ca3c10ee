"""Writes the results section of README.md from the JSON files that `svc_ros evaluate ... --json FILE` left in a folder.

    python benchmarks/readme_table.py [FOLDER]        (out/evaluate by default; --print shows it and writes nothing)

Files may have any name: data set and method are read from them, the newest file of each counts.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

PROJECT_ROOT = Path(__file__).resolve().parent.parent
FOLDER = PROJECT_ROOT / "out" / "evaluate"
BEGIN, END = "<!-- results -->", "<!-- /results -->"
SETS = (
    "os1_64_seosan", "hdl64_kitti_a", "hdl64_kitti_05_loop", "hdl32_easy", "rgbd_redkitchen", "os0_64_walk",
    "hdl64_kitti_negatives",
)  # fmt: skip
METHODS = ("svc", "svc_paper", "sc2")
HEAD = (
    "data set", "method", "pairs", "success rate", "candidate success rate", "false accepts", "decision F1",
    "decision precision", "register p50 [ms]",
)  # fmt: skip
Report = Mapping[str, Any]


def read_reports(folder: Path) -> dict[tuple[str, str], Report]:
    """The newest report of every data set and method; files that are no report are left out."""
    reports: dict[tuple[str, str], Report] = {}
    for path in sorted(folder.glob("*.json"), key=lambda p: (p.stat().st_mtime, p.name)):
        try:
            report = json.loads(path.read_text(encoding="utf-8"))
        except json.JSONDecodeError as error:
            raise ValueError(f"{path}: expected a JSON object, found {error}") from None
        if isinstance(report, dict) and {"dataset", "method", "registration"} <= report.keys():
            reports[report["dataset"], report["method"]] = report
    return reports


def table_of(reports: Mapping[tuple[str, str], Report]) -> str:
    """A Markdown table, one row a data set and method, in the order of `SETS` and then by name."""
    keys = sorted(reports, key=lambda key: (_place(key[0], SETS), key[0], _place(key[1], METHODS), key[1]))
    rows = [HEAD, ("---", "---", *["---:"] * (len(HEAD) - 2)), *(_row(reports[key]) for key in keys)]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def replace_section(text: str, section: str) -> str:
    """The text with what stands between the two markers replaced; ValueError unless each stands there once."""
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"expected one {BEGIN} and after it one {END}")
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{section}\n{END}{rest.split(END)[1]}"


def _row(report: Report) -> tuple[str, ...]:
    registration, decision = report["registration"], report.get("decision") or {}
    negatives = report.get("negatives") or {}
    num_pairs, num_negatives = registration["num_pairs"], negatives.get("num_pairs", 0)
    false_accepts = registration["num_false_accepted"] + negatives.get("num_false_accepted", 0)
    pairs = " + ".join(
        text for count, text in ((num_pairs, f"{num_pairs}"), (num_negatives, f"{num_negatives} negatives")) if count
    )
    shares = (registration["success_rate"], registration["candidate_success_rate"])
    qualities = (decision.get("f1"), decision.get("precision"))
    return (
        report["dataset"], f"`{report['method']}`", pairs, *map(_share, shares), str(false_accepts),
        *map(_share, qualities), _whole(report["time_ms"]["register_p50"]),
    )  # fmt: skip


def _share(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _whole(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}"


def _place(name: str, order: Iterable[str]) -> int:
    names = list(order)
    return names.index(name) if name in names else len(names)


def main(args: list[str] | None = None) -> int:
    """Exit code 0, or 2 where a folder that was named has no report, or the README no place for it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="folder of evaluate's JSON files")
    parser.add_argument("--readme", type=Path, default=PROJECT_ROOT / "README.md")
    parser.add_argument("--print", action="store_true", dest="only_print", help="show the table, write nothing")
    options = parser.parse_args(args)
    folder = options.folder or FOLDER
    try:
        reports = read_reports(folder)
        if not reports:
            print(f"{folder}: no reports of svc_ros evaluate, nothing written", file=sys.stderr)
            return 2 if options.folder else 0
        if options.only_print:
            print(table_of(reports))
            return 0
        text = options.readme.read_text(encoding="utf-8")
        options.readme.write_text(replace_section(text, table_of(reports)), encoding="utf-8")
    except (OSError, ValueError) as error:
        print(f"readme_table: {error}", file=sys.stderr)
        return 2
    print(f"{options.readme}: {len(reports)} rows")
    return 0


if __name__ == "__main__":
    sys.exit(main())
