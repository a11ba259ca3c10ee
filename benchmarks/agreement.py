"""Wrong loops among right ones: what the agreement over a run keeps, beside pairwise consistency and a robust graph.

    python benchmarks/agreement.py RUN... [--seeds N] [--name NAME] [--out DIR]

RUN: folders of `svc_ros replay --mode loop_closure --reference ...`. Wrong loops are put among the right ones that the
run accepted, by several seeds: `scattered` (three, anywhere within reach), `half` (as many as there are right ones),
`family` (five neighbours in a row that are all off by the same 4 m, as in a corridor that repeats) and `undecided
family` (the same, left undecided on their pairs with a probability of 0.7, which only the agreement takes at all).
Odometry is that of the run, and the same with drift added. Writes NAME.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import RESULTS, describe_run, print_table, write_report
from scipy.spatial.transform import Rotation

from svc_ros.core import se3
from svc_ros.core.config import Config, preset
from svc_ros.core.result import Reason
from svc_ros.io.results import read_jsonl, result_from_json
from svc_ros.io.trajectories import Trajectory, read_tum
from svc_ros.pipeline.agreement import Agreement, last_words
from svc_ros.pipeline.graph_optimisation import factors_of, load_gtsam, optimiser_parameters
from svc_ros.pipeline.pose_graph import build_pose_graph
from svc_ros.pipeline.stream import StreamDecision, leave_undecided

MAX_DEG, MAX_M = 5.0, 0.6  # a right loop is nearer than that to the reference
DRIFTS = {"as recorded": (0.0, 0.0), "2 %, 0.5 deg/m": (0.02, 0.5)}
CONSISTENT = 16.8  # 99 % of the squared errors of six degrees of freedom
FAMILY, FAMILY_M = 5, 4.0
UNDECIDED = "undecided family"


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What the comparison needs of a replay."""

    name: str
    loops: Sequence[StreamDecision]
    odometry: Trajectory
    config: Config


def read_run(folder: Path) -> Run:
    """The right loops of a replay that were accepted, and its odometry."""
    summary = json.loads((folder / "summary.json").read_text())
    odometry, reference = read_tum(folder / "trajectory_tum.txt"), read_tum(summary["reference"]["file"])
    known = set(odometry.stamps_ns.tolist())
    loops = []
    for record in read_jsonl(folder / "decisions.jsonl"):
        ends = record["source_stamp_ns"], record["target_stamp_ns"]
        result = result_from_json(record)
        if not result.accepted or record["origin"] == "agreement" or not set(ends) <= known:
            continue
        truth = se3.invert(reference.at(ends[1])) @ reference.at(ends[0])
        turn, shift = se3.pose_error(result.T_target_source, truth)
        if turn <= MAX_DEG and shift <= MAX_M:
            loops.append(StreamDecision(result, *ends, "lidar", "lidar"))
    return Run(folder.name, loops, odometry, preset(summary.get("chosen", {}).get("preset", summary["preset"])))


def drifting(odometry: Trajectory, share: float, deg_per_m: float) -> Trajectory:
    """Odometry whose every step is longer by a share and turned by an angle for each metre."""
    poses = [odometry.poses[0]]
    for step in se3.invert(odometry.poses[:-1]) @ odometry.poses[1:]:
        turn = Rotation.from_euler("z", deg_per_m * float(np.linalg.norm(step[:3, 3])), degrees=True).as_matrix()
        poses.append(poses[-1] @ se3.make_pose(step[:3, :3] @ turn, step[:3, 3] * (1.0 + share)))
    return Trajectory(odometry.stamps_ns, np.array(poses))


def off(loop: StreamDecision, T: np.ndarray, probability: float) -> StreamDecision:
    """The loop with another pose."""
    result = dataclasses.replace(loop.result, T_target_source=T, best_candidate=T, probability=probability)
    return dataclasses.replace(loop, result=result)


def wrong_loops(run: Run, kind: str, rng: np.random.Generator) -> list[StreamDecision]:
    """Wrong loops of one kind, accepted like the right ones, or undecided."""
    if kind == UNDECIDED:
        return [_left_undecided(loop) for loop in wrong_loops(run, "family", rng)]
    stamps = run.odometry.stamps_ns
    if kind == "family":
        first = int(rng.integers(0, len(run.loops) - FAMILY + 1))
        shift = se3.make_pose(np.eye(3), (float(rng.choice([-FAMILY_M, FAMILY_M])), 0.0, 0.0))
        some = run.loops[first : first + FAMILY]
        return [
            dataclasses.replace(off(d, d.result.T_target_source @ shift, 0.95), target_stamp_ns=_other(d, stamps))
            for d in some
        ]
    reach = run.config.loop_closure.max_distance_m
    found = []
    for _ in range(3 if kind == "scattered" else len(run.loops)):
        like = run.loops[int(rng.integers(len(run.loops)))]
        target = int(rng.choice(stamps[stamps < like.source_stamp_ns - 20_000_000_000]))
        turn = Rotation.from_euler("z", rng.uniform(-180.0, 180.0), degrees=True).as_matrix()
        T = se3.make_pose(turn, (*rng.uniform(-reach, reach, 2), 0.0))
        found.append(dataclasses.replace(off(like, T, float(rng.uniform(0.86, 0.99))), target_stamp_ns=target))
    return found


def _left_undecided(loop: StreamDecision) -> StreamDecision:
    likely = dataclasses.replace(loop.result, probability=0.7)
    return dataclasses.replace(loop, result=leave_undecided(likely, Reason.INSUFFICIENT_EVIDENCE, "not sure enough"))


def _other(loop: StreamDecision, stamps: np.ndarray) -> int:
    """A neighbour of the loop's target, so that the wrong loop is no second one on the same pair."""
    return int(stamps[max(int(np.searchsorted(stamps, loop.target_stamp_ns)) - 1, 0)])


def by_agreement(loops: Sequence[StreamDecision], odometry: Trajectory, config: Config) -> set[tuple[int, int]]:
    """What the package keeps."""
    agreement = Agreement(config)
    told = [d for loop in loops for d in agreement.add([loop], odometry)]
    return {_pair(d) for d in last_words(told) if d.result.accepted}


def by_consistency(loops: Sequence[StreamDecision], odometry: Trajectory, config: Config) -> set[tuple[int, int]]:
    """Pairwise consistency: the largest set found greedily from each loop in which no two disagree by odometry."""
    agreement = Agreement(config)
    agreement.add(loops, odometry)
    fits = ~agreement._relations[-1].contradicts
    best: list[int] = []
    for seed in range(len(loops)):
        members, free = [seed], fits[seed].copy()
        free[seed] = False
        while free.any():
            counts = np.where(free, (fits & free).sum(1), -1)
            members.append(int(np.argmax(counts)))
            free &= fits[members[-1]]
            free[members[-1]] = False
        best = max(best, members, key=len)
    return {_pair(loops[k]) for k in best}


def by_robust_graph(loops: Sequence[StreamDecision], odometry: Trajectory, config: Config) -> set[tuple[int, int]]:
    """Graduated non-convexity on the pose graph (gtsam), odometry trusted as far as the agreement does: loops that keep
    more than half a weight."""
    gtsam = load_gtsam()
    graph = build_pose_graph(odometry, loops, config.covariance)
    steps, limits = len(odometry) - 1, config.agreement
    drift = np.array([limits.drift_ratio] * 3 + [np.radians(limits.drift_deg_per_metre)] * 3)
    edges = [
        dataclasses.replace(e, covariance=e.covariance + np.diag(drift * np.linalg.norm(e.T_target_source[:3, 3])) ** 2)
        for e in graph.edges[:steps]
    ]
    graph = dataclasses.replace(graph, edges=[*edges, *graph.edges[steps:]])
    factors = factors_of(graph, np.arange(len(odometry)) == 0)
    first = gtsam.Values()
    for vertex in range(1, len(odometry)):
        first.insert(vertex, gtsam.Pose3(graph.poses[vertex]))
    parameters = gtsam.GncLMParams(optimiser_parameters())
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers(list(range(len(odometry) - 1)))
    optimiser = gtsam.GncLMOptimizer(factors, first, parameters)
    optimiser.setInlierCostThresholdsAtProbability(0.99)
    optimiser.optimize()
    weights = np.asarray(optimiser.getWeights())[len(odometry) - 1 :]
    return {_pair(loop) for loop, weight in zip(loops, weights, strict=True) if weight > 0.5}


METHODS: dict[str, Callable[[Sequence[StreamDecision], Trajectory, Config], set[tuple[int, int]]]] = {
    "agreement": by_agreement, "pairwise consistency": by_consistency, "robust graph (GNC)": by_robust_graph,
}  # fmt: skip


def main() -> None:
    """Compare, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="*", metavar="RUN", help="without one nothing is compared")
    parser.add_argument("--seeds", type=int, default=10, help="times that wrong loops are drawn")
    parser.add_argument("--name", default="agreement", help="of the JSON file")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for it")
    options = parser.parse_args()
    runs = [run for run in map(read_run, options.runs) if len(run.loops) >= FAMILY]
    if not runs:
        print("nothing to compare: name folders of replays with a reference and five right loops or more")
        return
    rows = [
        {"odometry": drift, "injected": kind, "method": method, **counts}
        for drift, how in DRIFTS.items()
        for kind in ("scattered", "half", "family", UNDECIDED)
        for method, counts in compare(runs, kind, how, options.seeds).items()
    ]
    print_table("Loops kept", ("odometry, wrong loops, method", *list(rows[0])[3:]), [
        (", ".join(list(row.values())[:3]), *list(row.values())[3:]) for row in rows])  # fmt: skip
    about = {"runs": [run.name for run in runs], "num_right_loops": [len(run.loops) for run in runs]}
    values = {**about, "num_seeds": options.seeds, "rows": rows}
    write_report(options.out / f"{options.name}.json", values, describe_run([]))


def compare(runs: Sequence[Run], kind: str, drift: tuple[float, float], num_seeds: int) -> dict[str, dict[str, Any]]:
    """Right and wrong loops kept by each method, of how many, over all runs and seeds."""
    totals = {name: dict.fromkeys(("right_kept", "right", "wrong_kept", "wrong"), 0) for name in METHODS}
    for number, run in enumerate(runs):
        odometry = drifting(run.odometry, *drift)
        for seed in range(num_seeds):
            wrong = wrong_loops(run, kind, np.random.default_rng([number, seed]))
            right = {_pair(d) for d in run.loops}
            wrong = list({_pair(d): d for d in wrong if _pair(d) not in right}.values())
            loops = [_placed(d, odometry) for d in sorted([*run.loops, *wrong], key=_pair)]
            for name, keep in METHODS.items():
                if kind == UNDECIDED and name != "agreement":
                    continue
                kept = keep(loops, odometry, run.config)
                totals[name]["right_kept"] += len(kept & right)
                totals[name]["wrong_kept"] += len(kept - right)
                totals[name]["right"] += len(right)
                totals[name]["wrong"] += len(wrong)
    return {name: counts for name, counts in totals.items() if counts["right"]}


def _placed(loop: StreamDecision, odometry: Trajectory) -> StreamDecision:
    source, target = (odometry.at(stamp) for stamp in _pair(loop))
    return dataclasses.replace(loop, T_odom_source=source, T_odom_target=target)


def _pair(decision: StreamDecision) -> tuple[int, int]:
    return decision.source_stamp_ns, decision.target_stamp_ns


if __name__ == "__main__":
    main()
