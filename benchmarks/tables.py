"""Writes the measured tables of the README and of two pages in docs/ from the JSON files in benchmarks/results.

    python benchmarks/tables.py [--check]        (--check writes nothing; exit code 1 where a page is out of date)

A section stands between `<!-- name -->` and `<!-- /name -->`; decision.py, registration.py and compare.py measure
what it shows.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lib import registration_pages
from lib.markdown import share, table

from svc_ros.core.config import preset, walk

PROJECT_ROOT = Path(__file__).resolve().parent.parent
RESULTS = PROJECT_ROOT / "benchmarks" / "results"
PAGES = tuple(PROJECT_ROOT / page for page in ("README.md", "docs/how_it_decides.md", "docs/benchmarks.md"))
MEASURED = ("decision", "registration", "latest")
RECORDED, ALL, TRAFFIC, ROOMS = "recorded sets", "all sets", "simulated traffic", "simulated rooms"
RULES = {  # as decision.py names them -> as the pages do
    "svc": "`svc`",
    "svc, weights of the other sensors": "`svc`, weights fitted without the tested sensor",
    "svc, not refined": "`svc`, not refined",
    "svc, nothing denied": "`svc`, nothing denied",
    "denied share alone": "denied share below 0.08 alone, nothing fitted",
    "logistic, no sight lines": "logistic regression without sight lines, fitted without the tested sensor",
    "overlap 0.3": "overlap of at least 0.3",
    "svc_paper": "`svc_paper`, the published rule",
}
PARTS = {  # what is taken away, as decision.py names it -> as the page does
    "svc": "nothing",
    "svc, not refined": "refinement before judging",
    "svc, nothing denied": "all that the other sensor looked through",
    "svc, plain overlap": "oriented overlap (plain overlap in its place)",
    "svc, opposed surfaces allowed": "`decision.max_opposed_per_overlap`",
    "svc, one plane is enough": "`decision.min_constraint`",
    "svc, no doubt by slips": "doubts by slips",
    "svc, no doubt by half turns": "doubts by half turns",
}
WEIGHTS = {  # of DecisionConfig -> the number that it weighs
    "offset": "offset",
    "denied_weight": "- log of the denied share of what the other sensor could see, both ways",
    "wide_denied_weight": "- log of the same, clusters of denied surface counting by the angle they are seen over",
    "structure_weight": "+ log of the weakest constraint: how much the agreeing surfaces resist a shift",
}
TIMES = {  # as the page names it -> where latest.json has it
    "`register`": ("register",),
    "`register`, target described before": ("register", "reused"),
    "`verify`, both scans prepared": ("verify",),
    "KISS-Matcher, 0.3 m": ("kiss_matcher",),
    "Open3D RANSAC on FPFH": ("open3d_ransac",),
}
Report = Mapping[str, Any]


def rules_table(results: Report) -> str:
    """Every rule on the recorded sets, and on all."""
    recorded, both = results["decision"]["decision"][RECORDED], results["decision"]["decision"][ALL]
    head = ("rule", "F1", "false accepts", "AUC", "F1, simulated too", "false accepts, simulated too")
    rows = [
        (told, *_quality(recorded[rule]), share(recorded[rule]["roc_auc"]), *_quality(both[rule]))
        for rule, told in RULES.items()
    ]
    return table(head, rows)


def left_out_table(results: Report) -> str:
    """Each sensor by weights that were fitted without it, and by the published rule."""
    tables, rows = results["decision"]["decision"], []
    errors = results["decision"]["calibration"]["expected_calibration_error"]
    for name in results["decision"]["weights"]["leave_one_sensor_out"]:
        own, paper = tables[name]["svc, weights of the other sensors"], tables[name]["svc_paper"]
        right, wrong = own["num_correct"], own["num_wrong"]
        counts = (f"{right - _refused(own)} of {right}" if right else "", f"{own['num_false_accepted']} of {wrong}")
        quality = (share(own["f1"] if right else None), share(errors[name]))
        of_paper = f"{right - _refused(paper)} of {right}" if right else ""
        rows.append((name, *counts, *quality, of_paper, str(paper["num_false_accepted"])))
    head = (
        "sensor left out of the fit", "right poses accepted", "wrong ones accepted", "F1", "calibration error",
        "right ones accepted by `svc_paper`", "wrong ones",
    )  # fmt: skip
    return table(head, rows)


def calibration_error(results: Report) -> str:
    """Of all answers on left-out sensors."""
    return share(results["decision"]["calibration"]["expected_calibration_error"][ALL])


def weights_table(results: Report) -> str:
    """Configured and fitted weights, and how far they move when a sensor is left out."""
    weights = results["decision"]["weights"]
    rows = []
    for name, told in WEIGHTS.items():
        moved = [test["weights"][name] for test in weights["leave_one_sensor_out"].values()]
        values = (weights["configured"][name], weights["fitted_to_all"][name])
        rows.append((f"`decision.{name}`", told, *map(str, values), f"{min(moved)} to {max(moved)}"))
    return table(("value", "what it weighs", "configured", "fitted to all sensors", "with one sensor left out"), rows)


def margins_table(results: Report) -> str:
    """The margins nearest to the border, by sensor: as configured, and by weights that never saw the sensor."""
    counts, rows = results["decision"]["weights"]["num_right_and_wrong"], []
    for name, test in results["decision"]["weights"]["leave_one_sensor_out"].items():
        own, right, wrong = test["as_configured"], *counts[name]
        nearest = [t[key] for key in ("smallest_right_margin", "largest_wrong_margin") for t in (own, test)]
        rows.append((name, str(right), str(wrong), *map(_margin, nearest)))
    head = (
        "sensor", "right poses", "wrong poses in contact", "smallest right margin", "the same, left out of the fit",
        "largest wrong margin", "the same, left out of the fit",
    )  # fmt: skip
    return table(head, rows)


def parts_table(results: Report) -> str:
    """What each part of the rule is good for: answers without it."""
    recorded, both = results["decision"]["decision"][RECORDED], results["decision"]["decision"][ALL]
    rows = [
        (told, *_quality(recorded[rule]), *_quality(both[rule]), *(_of_set(results, name, rule) for name in HARD))
        for rule, told in PARTS.items()
    ]
    return table((*_PARTS_HEAD, *HARD.values()), rows)


def numbers_table(results: Report) -> str:
    """The same for each of the weighed numbers, the others fitted again, each sensor by the weights of the others."""
    rule = "svc, weights of the other sensors"
    weighed = ("denied", "wide_denied", "structure")
    names = {rule: "nothing", **{f"{rule}, no {name}": name.replace("_", " ") for name in weighed}}
    recorded, both = results["decision"]["decision"][RECORDED], results["decision"]["decision"][ALL]
    rows = [
        (told, *_quality(recorded[name]), *_quality(both[name]), *(_of_set(results, hard, name) for hard in HARD))
        for name, told in names.items()
    ]
    return table((*_PARTS_HEAD, *HARD.values()), rows)


_PARTS_HEAD = ("taken away", "F1", "false accepts", "F1, simulated too", "false accepts, simulated too")
HARD = {TRAFFIC: "true poses in traffic refused", ROOMS: "wrong poses in alike rooms accepted"}


def sets_table(results: Report) -> str:
    """False accepts and recall of three rules on each set."""
    rules = {"svc": "`svc`", "overlap 0.3": "overlap 0.3", "svc_paper": "`svc_paper`"}
    rows = []
    for name, num in results["decision"]["num_poses"].items():
        told = [results["decision"]["decision"][name][rule] for rule in rules]
        poses = (f"`{name}`" if " " not in name else name, str(num))
        rows.append((*poses, *(str(t["num_false_accepted"]) for t in told), *(share(t["recall"]) for t in told)))
    head = ("set", "poses", *(f"{what}, {rule}" for what in ("false accepts", "recall") for rule in rules.values()))
    return table(head, rows)


def covariance_table(results: Report) -> str:
    """Share of true errors within two sigma."""
    rows = [
        (f"`{name}`" if " " not in name else name, str(found["num_pairs"]), share(found["within_2_sigma"]),
         share(min(found["within_2_sigma_by_axis"].values())))
        for name, found in results["decision"]["covariance"].items()
    ]  # fmt: skip
    return table(("set", "pairs", "within 2 sigma, all six axes at once", "the worst single axis"), rows)


def borders_table(_: Report) -> str:
    """Every value of the decision that is no weight, of each preset where they differ."""
    values = [
        {info.name: info for info in walk(preset(name))} for name in ("lidar_outdoor", "lidar_indoor", "rgbd_indoor")
    ]
    rows = []
    for name, info in values[0].items():
        group, _, own = name.partition(".")
        if group == "decision" and own not in WEIGHTS:
            different = dict.fromkeys(str(preset_values[name].default) for preset_values in values)
            unit = f" [{info.unit}]" if info.unit else ""
            rows.append((f"`{name}`", " / ".join(different), f"{info.description}{unit}"))
    return table(("border", "value", "meaning"), rows)


def rooms_accepted(results: Report) -> str:
    """How many pairs of rooms that look alike are accepted."""
    found = results["decision"]["decision"][ROOMS]["svc"]
    return f"{found['num_false_accepted']} of {found['num_wrong']}"


def traffic_refused(results: Report) -> str:
    """How many true poses in traffic are not accepted."""
    found = results["decision"]["decision"][TRAFFIC]["svc"]
    return f"{_refused(found)} of {found['num_correct']}"


def pose_counts(results: Report) -> str:
    """How many labelled poses there are."""
    recorded = {name: num for name, num in results["decision"]["num_poses"].items() if not name.startswith("simulated")}
    simulated = sum(results["decision"]["num_poses"].values()) - sum(recorded.values())
    return f"{sum(recorded.values())} labelled poses of {len(recorded)} recorded sets and {simulated} simulated ones"


def times_table(results: Report) -> str:
    """From raw points to the answer, beside other programs."""
    rows = []
    for told, (method, *variant) in TIMES.items():
        found = results["latest"][method]
        for key in variant:
            found = found[key]
        right = f"{round(found['recall'] * found['pairs'])} of {found['pairs']}"
        ratio = f"{found['ratio_vs_kiss_matcher']:.2g}"
        rows.append((told, f"{found['time_ms_p50']:.0f}", ratio, right))
    return table(("", "median [ms]", "against KISS-Matcher", "accepted and right"), rows)


SECTIONS: dict[str, Callable[[Report], str]] = {
    "decision rules": rules_table, "left out": left_out_table, "weights": weights_table, "margins": margins_table,
    "parts": parts_table, "numbers": numbers_table, "by set": sets_table, "covariance": covariance_table,
    "borders": borders_table, "rooms accepted": rooms_accepted, "traffic refused": traffic_refused,
    "pose counts": pose_counts, "times": times_table, "calibration error": calibration_error,
    **registration_pages.SECTIONS,
}  # fmt: skip


def fill(text: str, results: Report) -> str:
    """The text with every section that it has written anew; ValueError where a mark is not closed."""
    for name, section in SECTIONS.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if text.count(begin) != text.count(end):
            raise ValueError(f"expected as many {end} as {begin}, found {text.count(end)} and {text.count(begin)}")
        before, *parts = text.split(begin)
        for part in parts:
            written = section(results)
            block = f"\n{written}\n" if written.startswith("|") else written
            before += f"{begin}{block}{end}{part.partition(end)[2]}"
        text = before
    return text


def _of_set(results: Report, name: str, rule: str) -> str:
    found = results["decision"]["decision"][name][rule]
    if name == TRAFFIC:
        return f"{_refused(found)} of {found['num_correct']}"
    return f"{found['num_false_accepted']} of {found['num_wrong']}"


def _refused(found: Report) -> int:
    return round((1.0 - found["recall"]) * found["num_correct"])


def _quality(found: Report) -> tuple[str, str]:
    return share(found["f1"]), str(found["num_false_accepted"])


def _margin(value: float | None) -> str:
    return "" if value is None else f"{value:+.2f}"


def read_results(folder: Path) -> dict[str, Report]:
    """The files that the tables are made of, by name."""
    return {name: json.loads((folder / f"{name}.json").read_text("utf-8")) for name in MEASURED}


def main(args: list[str] | None = None) -> int:
    """Exit code 0; 1 with --check where a page is out of date; 2 where a file is missing or a mark not closed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing")
    options = parser.parse_args(args)
    old = []
    try:
        results = read_results(RESULTS)
        for page in PAGES:
            text = page.read_text(encoding="utf-8")
            written = fill(text, results)
            old += [page] if written != text else []
            if not options.check:
                page.write_text(written, encoding="utf-8")
    except (OSError, ValueError, KeyError) as error:
        print(f"tables: {error}", file=sys.stderr)
        return 2
    print("\n".join(f"{page}: {'out of date' if options.check else 'written'}" for page in old) or "nothing to do")
    return int(options.check and bool(old))


if __name__ == "__main__":
    sys.exit(main())
