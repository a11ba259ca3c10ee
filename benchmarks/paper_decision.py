"""Table 5 of the paper: the decision version of the problem. Is the pose that SC2-PCR estimates for a pair right?

    python benchmarks/paper_decision.py [--data DIR] [--limit N] [--3dmatch DIR] [--3dlomatch DIR] [--kitti DIR]

Each pair gives two estimated poses, as in the paper: there from two descriptors, here from FPFH by one-way and by
mutual matches (one where correspondences are given). A pose is right within the set's thresholds. The baseline accepts
all. Sets beyond the paper's follow, of them scans without any alignment, where nothing may be accepted. Writes
paper-decision.json and paper-decision.png.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import Dataset, describe_run, parse_options, print_table, spread, write_report
from lib.figures import new_bars, write_figure
from lib.pairs import choose
from lib.paper import add_benchmarks, choose_pairs, config_for, other_sets, read_columns, read_inputs

from svc_ros.core.config import with_values
from svc_ros.core.registration import register, verify
from svc_ros.core.se3 import pose_error
from svc_ros.core.sight import paper_rule
from svc_ros.evaluation.metrics import LabelledDecision, decision_metrics
from svc_ros.io.datasets import Pair

BASELINE, PAPER, OURS = "baseline", "svc_paper", "svc"
RULES = (BASELINE, PAPER, OURS)
# precision, recall, F1 [%]
PUBLISHED = {
    "3DMatch": {BASELINE: (88.5, 100.0, 93.9), PAPER: (98.1, 95.7, 96.9)},
    "3DLoMatch": {BASELINE: (48.5, 100.0, 65.4), PAPER: (88.7, 88.3, 88.5)},
}
MORE = ("os1_64_seosan", "os0_64_walk", "hdl64_kitti_negatives")
STRATEGIES = ("one_way", "mutual")
HEAD = ("set", "rule", "poses", "right", "precision [%]", "recall [%]", "F1 [%]", "false accepts", "published F1 [%]")
KEPT = ("num_correct", "num_wrong", "precision", "recall", "f1")
Table = dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class Judged:
    """One estimated pose: whether it is right, and the rules' answers."""

    title: str
    source: str
    target: str
    strategy: str
    correct: bool
    accepted: Mapping[str, bool]
    probability: float | None


def main() -> None:
    """Estimate, judge, print, write."""
    options = parse_options("The decision version: table 5 of the paper.", extend)
    columns = read_columns(options)
    sets = {column.title.replace(" FPFH", ""): column.dataset for column in columns}
    sets |= {dataset.name: dataset for dataset in other_sets(options.data, MORE)}
    run = describe_run(list(sets.values()))
    jobs = [(title, strip(d), pair) for title, d in sets.items() for pair in pairs_of(d, options.limit)]
    judged = [one for of_pair in spread(judge_pair, jobs, options.workers, "pairs") for one in of_pair]
    table = tabulate(judged)
    print_table("Table 5", HEAD, rows_of(table))
    draw(table, options.out / "paper-decision.png")
    values = {"table": "Tab. 5", "limit": options.limit, "decision": table, "published": PUBLISHED,
              "poses": [dataclasses.asdict(one) for one in judged]}  # fmt: skip
    write_report(options.out / "paper-decision.json", values, run)


def extend(parser: argparse.ArgumentParser) -> None:
    """Options of this script."""
    add_benchmarks(parser)
    parser.add_argument("--limit", type=int, default=15, metavar="N", help="pairs of each set, evenly over overlap")


def strip(dataset: Dataset) -> Dataset:
    """The data set as it travels to another process."""
    return dataclasses.replace(dataset, pairs=[], negatives=[], candidates=[])


def pairs_of(dataset: Dataset, limit: int) -> list[Pair]:
    """Pairs with a reference and pairs without alignment."""
    return choose_pairs(dataset, limit) + choose(dataclasses.replace(dataset, pairs=[]), limit)


def judge_pair(job: tuple[str, Dataset, Pair]) -> list[Judged]:
    """The estimates of one pair, judged by every rule."""
    title, dataset, pair = job
    config = config_for(dataset, "sc2")
    source, target, given = read_inputs(dataset, pair, config)
    judged = []
    for strategy in STRATEGIES if given is None else ("given",):
        changed = config if given is not None else with_values(config, {"matching.strategy": strategy})
        T = register(source, target, changed, given).best_candidate
        if T is None:
            continue  # no estimate: nothing to accept, as in the paper
        result = verify(source, target, T, config_for(dataset, OURS))
        *_, passed = paper_rule.check_both_ways(source.prepared, target.prepared, T, config.paper)
        accepted = {BASELINE: True, PAPER: bool(passed), OURS: result.accepted}
        correct = is_right(dataset, pair, T)
        judged.append(Judged(title, pair.source, pair.target, strategy, correct, accepted, result.probability))
    return judged


def is_right(dataset: Dataset, pair: Pair, T: np.ndarray) -> bool:
    """Within the set's thresholds; a pair without alignment has no right pose."""
    if pair.T_target_source is None:
        return False
    rotation, translation = pose_error(T, pair.T_target_source)
    return rotation <= dataset.success.rotation_deg and translation <= dataset.success.translation_m


def tabulate(judged: Sequence[Judged]) -> Table:
    """Numbers by set and rule."""
    titles = dict.fromkeys(one.title for one in judged)
    return {t: {rule: summarise([one for one in judged if one.title == t], rule) for rule in RULES} for t in titles}


def summarise(judged: Sequence[Judged], rule: str) -> dict[str, Any]:
    """Precision, recall and F1 of one rule, and its false accepts."""
    decisions = [LabelledDecision(one.accepted[rule], one.correct, None) for one in judged]
    return {
        "num_poses": len(decisions),
        **{name: value for name, value in decision_metrics(decisions).items() if name in KEPT},
        "num_false_accepted": sum(d.accepted and not d.correct for d in decisions),
    }


def rows_of(table: Table) -> list[list[Any]]:
    """Lines to print."""
    return [
        [title, rule, values["num_poses"], values["num_correct"], *(_percent(values[k]) for k in KEPT[2:]),
         values["num_false_accepted"], PUBLISHED.get(title.partition(":")[0], {}).get(rule, (None,) * 3)[2]]
        for title, of_set in table.items()
        for rule, values in of_set.items()
    ]  # fmt: skip


def draw(table: Table, path: Path) -> None:
    """F1 by set, a bar a rule; a line across a bar is what the paper reports on the whole benchmark."""
    shown = {title: of_set for title, of_set in table.items() if of_set[BASELINE]["num_correct"]}
    bars = [
        {rule: (of_set[rule]["f1"] or 0.0, _published_f1(title, rule)) for rule in RULES}
        for title, of_set in shown.items()
    ]
    numbers = [of_set[BASELINE]["num_poses"] for of_set in shown.values()]
    labels = [f"{title.replace(': ', chr(10))}\n{num} poses" for title, num in zip(shown, numbers, strict=True)]
    told = {"ylim": (0.0, 1.05), "ylabel": "F1", "title": "Table 5; black lines: the paper, on the whole benchmark"}
    write_figure(new_bars(labels, RULES, bars, 2.2, **told), path)


def _published_f1(title: str, rule: str) -> float | None:
    published = PUBLISHED.get(title.partition(":")[0], {}).get(rule)
    return None if published is None else 0.01 * published[2]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


if __name__ == "__main__":
    main()
