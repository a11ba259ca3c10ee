"""How long does each stage take, and how does it grow? Against points, correspondences and hypotheses, and twins.

    python benchmarks/stages.py [--points N ...] [--correspondences N ...] [--poses K ...] [--rounds N]

Writes the sections `stages`, `svc_check`, `hypotheses` and `icp` of latest.json, and stages.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from lib.cases import (
    Case,
    SizedPair,
    choose_evenly,
    choose_sets,
    correspond,
    forget,
    read_case,
    spread_indices,
    thin_pair,
)
from lib.checks import compare_checks, compare_hypotheses
from lib.common import console, describe_run, parse_options, print_table, read_datasets
from lib.icp_check import compare_icp
from lib.latest import record
from lib.stage_plot import draw
from lib.timing import exponent, medians, time_in_turns

from svc_ros.core.config import with_values
from svc_ros.core.matches.features import compute_features
from svc_ros.core.matches.matching import match
from svc_ros.core.range_image import build_range_image
from svc_ros.core.registration import verify
from svc_ros.core.scan import Array, Correspondences
from svc_ros.core.scans.preprocess import estimate_normals, thin_on_voxel_grid
from svc_ros.core.search import hypotheses as generation
from svc_ros.core.search.compatibility import compute_compatibility
from svc_ros.core.search.icp import refine_by_icp
from svc_ros.core.search.shortlist import order_by_agreement
from svc_ros.core.sight.sight_view import gather_evidence, glance

POINTS = (2000, 5000, 10_000, 15_000, 20_000)
CORRESPONDENCES = (500, 1000, 2000, 3500, 5000)
POSES = (200, 500, 1000, 2000)
POSES_OF_A_SCAN = 500  # what pre-scoring gets where the number of points grows
Jobs = dict[str, Callable[[], Any]]
Table = dict[str, dict[str, Any]]


def main() -> None:
    """Run, print, write."""
    options = parse_options("Time every stage against the size of its input.", extend, workers=False)
    datasets = choose_sets(read_datasets(options.data))
    run = describe_run(datasets)
    cases = [read_case(dataset) for dataset in datasets]
    largest = max(cases, key=lambda case: len(case.source))
    checks = compare_checks(cases, options.points, options.check_at, options.rounds)
    matches = correspond(largest, options.correspondences[-1])
    found = compare_hypotheses(matches, largest.config.hypotheses, max(3, options.rounds // 2))
    refined = compare_icp(cases, options.rounds)
    tables = {
        "points": against_points(largest, options.points, options.rounds),
        "correspondences": against_correspondences(largest, matches, options.correspondences, options.rounds),
        "hypotheses": against_poses(largest, matches, thin_pair(largest, options.check_at), options),
    }
    show(tables, {"svc_check": checks, "hypotheses": found, "icp": refined})
    draw(tables, checks["curves"], options.out / "stages.png")
    stages = {"dataset": largest.name, **tables}
    found["exponent"] = tables["correspondences"]["hypotheses"]["exponent"]
    record(options.out, "stages", run, {"stages": stages, "svc_check": checks, "hypotheses": found, "icp": refined})


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    parser.add_argument("--points", type=int, nargs="+", default=POINTS, metavar="N", help="points of a scan")
    parser.add_argument("--check-at", type=int, default=10_000, metavar="N", help="points of the sight-view comparison")
    parser.add_argument("--correspondences", type=int, nargs="+", default=CORRESPONDENCES, metavar="N",
                        help="correspondences; the last number is the one of the comparison")  # fmt: skip
    parser.add_argument("--poses", type=int, nargs="+", default=POSES, metavar="K", help="hypotheses")
    parser.add_argument("--rounds", type=int, default=5, help="times that every call is measured")


def against_points(case: Case, numbers: Sequence[int], rounds: int) -> Table:
    """Milliseconds of every stage whose input is one scan or two."""
    return grow({num: point_stages(case, thin_pair(case, num), num / max(numbers)) for num in numbers}, rounds)


def point_stages(case: Case, pair: SizedPair, share: float) -> Jobs:
    """The stages for scans of one size. The voxel grid gets that share of the raw points.

    `sight view` and `glance` look both ways and have their search structures, `first sight view` has to build them.
    """
    source, target, config = pair.source, pair.target, pair.config
    raw = case.source.points[spread_indices(len(case.source), int(share * len(case.source)))]
    described = [compute_features(scan, config) for scan in (source, target)]
    T = case.T_target_source
    many = poses_around(T, POSES_OF_A_SCAN)
    return {
        "voxel grid": lambda: thin_on_voxel_grid(raw, source.voxel_size_m),
        "normals": lambda: estimate_normals(source.points, source.sensor_origin, config.preprocess),
        "range image": lambda: build_range_image(raw, source.sensor_origin, 1.0, source.beam_spacing_deg),
        "FPFH": lambda: compute_features(source, config),
        "matching of all": lambda: match(*described, config.matching),
        "first matching": lambda: match(*described, config.matching, config.matching.first_points),
        "first sight view": lambda: gather_evidence(forget(source), forget(target), T, config.sight_view),
        "sight view": lambda: gather_evidence(source, target, T, config.sight_view),
        "glance": lambda: glance(source, target, T, config.sight_view),
        "pre-scoring": lambda: order_by_agreement(many, source, target, config),
        "ICP": lambda: refine_by_icp(T, source, target, config, config.shortlist.icp_last_points),
        "verify": lambda: verify(source, target, T, config),
    }


def against_correspondences(case: Case, matches: Correspondences, numbers: Sequence[int], rounds: int) -> Table:
    """Milliseconds of what works on correspondences."""
    config = case.config.hypotheses

    def jobs(chosen: Correspondences) -> Jobs:
        return {
            "compatibility": lambda: compute_compatibility(chosen, config.compatibility_threshold_m),
            "hypotheses": lambda: generation.generate_hypotheses(chosen, config),
        }

    return grow({num: jobs(choose_evenly(matches, num)) for num in numbers}, rounds)


def against_poses(case: Case, matches: Correspondences, pair: SizedPair, options: argparse.Namespace) -> Table:
    """Milliseconds of what works on many poses: generation from that many seeds, ranking, pre-scoring."""
    config = with_values(case.config, {"hypotheses.seed_ratio": 1.0, "hypotheses.nms_radius_m": 0.0})

    def jobs(num: int) -> Jobs:
        seeded = with_values(config, {"hypotheses.max_seeds": num}).hypotheses
        T = poses_around(case.T_target_source, num)
        return {
            "generation": lambda: generation.generate_hypotheses(matches, seeded),
            "ranking": lambda: generation.rank(T, matches, seeded),
            "pre-scoring": lambda: order_by_agreement(T, pair.source, pair.target, case.config),
        }

    return grow({num: jobs(num) for num in options.poses}, options.rounds)


def poses_around(T: Array, num: int) -> Array:
    """Poses (num, 4, 4) within 2 m of T."""
    poses = np.repeat(T[None], num, axis=0)
    poses[:, :3, 3] += np.random.default_rng(0).uniform(-2.0, 2.0, (num, 3))
    return poses


def grow(jobs_by_number: Mapping[int, Jobs], rounds: int) -> Table:
    """Median milliseconds of every stage at every number, and the exponent; all numbers of a stage take turns."""
    numbers = list(jobs_by_number)
    table: Table = {}
    for stage in jobs_by_number[numbers[0]]:
        times = medians(time_in_turns({num: jobs_by_number[num][stage] for num in numbers}, rounds))
        values = [times[num] for num in numbers]
        table[stage] = {"number": numbers, "time_ms": values, "exponent": exponent(numbers, values)}
    return table


def show(tables: Mapping[str, Table], sections: Mapping[str, Mapping[str, Any]]) -> None:
    """Print what was measured."""
    for name, table in tables.items():
        numbers = next(iter(table.values()))["number"]
        rows = [(stage, *values["time_ms"], values["exponent"]) for stage, values in table.items()]
        print_table(f"milliseconds against {name}", ("stage", *map(str, numbers), "exponent"), rows)
    for title, values in sections.items():
        for name, value in values.items():
            if isinstance(value, float):
                console.print(f"{title}.{name} = {value:.3g}")


if __name__ == "__main__":
    main()
