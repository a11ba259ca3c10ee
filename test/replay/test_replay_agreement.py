"""Later words on loops in a replay: in decisions, graph, summary and report; and the way after the loops."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from replay_cases import CONFIG, STAMPS, WAY, StopAfter, job, read_decisions, timeless_lines, write_room_bag
from replay_cases import write_reference as write_way

from svc_ros.core import se3
from svc_ros.core.config import Config, with_values
from svc_ros.core.errors import MissingDependencyError
from svc_ros.core.result import RegistrationResult
from svc_ros.io.bags import Bag
from svc_ros.io.g2o import read_g2o
from svc_ros.io.trajectories import read_tum
from svc_ros.pipeline.keyframes import Keyframe
from svc_ros.pipeline.loop_closure import judge_candidate
from svc_ros.replay import known as replay_known
from svc_ros.replay import optimised
from svc_ros.replay.run import replay_bag

ROUGH = with_values(CONFIG, {"agreement.drift_ratio": 0.25, "agreement.independent_m": 0.2})
WRONG_M = 0.78  # odometry may have drifted by so much since the target, but not on the way to the next loop


def judge_one_wrongly(
    source: Keyframe, target: Keyframe, guess: np.ndarray | None, config: Config
) -> RegistrationResult:
    result = judge_candidate(source, target, guess, config)
    if source.scan.stamp_ns != STAMPS[4]:
        return result
    T = se3.make_pose(np.eye(3), (0.0, WRONG_M, 0.0)) @ result.T_target_source
    return dataclasses.replace(result, T_target_source=T, best_candidate=T, probability=0.9)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("agreement") / "room")


@pytest.fixture(scope="module")
def run(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the first loop is accepted and wrong."""
    out = tmp_path_factory.mktemp("run") / "out"
    reference = write_way(out.parent / "reference.txt")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replay_known, "judge_candidate", judge_one_wrongly)
        replay_bag(job(
            bag, out, "loop_closure", config=ROUGH, odometry_frame="odom", reference=reference, report=True,
        ))  # fmt: skip
    return out


def test_a_wrong_loop_that_was_accepted_alone_is_withdrawn_in_a_decision_of_its_own(run: Path) -> None:
    rows = read_decisions(run)
    about = [row for row in rows if row["source_stamp_ns"] == STAMPS[4]]
    assert [(row["verdict"], row["reason"]) for row in about] == [("accepted", "ok"), ("undecided", "unconfirmed")]
    assert [row["origin"] for row in about] == ["odometry", "agreement"]
    assert [row["source_index"] for row in about] == [4, 4]
    assert about[0]["target_index"] == about[1]["target_index"]
    assert about[1]["T_target_source"] is None
    assert rows.index(about[1]) > rows.index(next(row for row in rows if row["source_stamp_ns"] == STAMPS[5]))
    with Bag(run / "results.mcap") as recorded:
        (told,) = (topic.count for topic in recorded.topics if topic.name.endswith("/decision"))
    assert told == len(rows)


def test_graph_summary_and_report_have_the_last_word(run: Path) -> None:
    rows, summary = read_decisions(run), json.loads((run / "summary.json").read_text())
    num_pairs = len({(row["source_stamp_ns"], row["target_stamp_ns"]) for row in rows})
    assert summary["num_decisions"] == num_pairs
    assert summary["num_revised"] == len(rows) - num_pairs
    assert summary["verdicts"]["undecided"] == summary["reasons"]["unconfirmed"] == 1
    assert summary["false_loops"] == 0
    accepted = summary["verdicts"]["accepted"]
    graph = read_g2o(run / "loops.g2o")
    assert len(graph.edges) == len(graph.poses) - 1 + accepted
    assert 4 not in {edge.source for edge in graph.edges[len(graph.poses) - 1 :]}
    page = (run / "report.html").read_text()
    (counts,) = re.findall(r'"counts": ?(\{"accepted": ?\d[^}]*\})', page)
    assert json.loads(counts) == {name: summary["verdicts"][name] for name in json.loads(counts)}


def test_a_continued_run_has_the_same_words(
    run: Path, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay_known, "judge_candidate", judge_one_wrongly)
    reference = write_way(tmp_path / "reference.txt")
    wanted = job(bag, tmp_path / "out", "loop_closure", config=ROUGH, odometry_frame="odom", reference=reference)
    replay_bag(wanted, should_stop=StopAfter(6))
    summary = replay_bag(dataclasses.replace(wanted, resume=True))
    assert timeless_lines(tmp_path / "out") == timeless_lines(run)
    whole = json.loads((run / "summary.json").read_text())
    for name in ("num_decisions", "num_revised", "verdicts", "reasons", "graph", "false_loops"):
        assert summary[name] == whole[name]


def test_the_way_after_the_loops_is_beside_odometry_with_both_errors(run: Path) -> None:
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    summary = json.loads((run / "summary.json").read_text())
    odometry, way = (read_tum(run / f"trajectory{name}_tum.txt") for name in ("", "_optimized"))
    assert way.stamps_ns.tolist() == odometry.stamps_ns.tolist()
    assert summary["optimized"] == {"num_poses": len(WAY)}
    errors = summary["reference"]
    assert errors["optimized"]["num_poses_compared"] == len(WAY)
    assert errors["optimized"]["ape"]["translation_m"]["rmse"] < 0.05
    assert '"optimized": [[' in (run / "report.html").read_text().replace('"optimized":[[', '"optimized": [[')


def test_without_gtsam_a_note_says_so(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(graph: object) -> None:
        raise MissingDependencyError("optimising needs gtsam")

    monkeypatch.setattr(optimised, "optimise_poses", missing)
    summary = replay_bag(job(bag, tmp_path, "loop_closure", odometry_frame="odom"))
    assert summary["optimized"] == {"note": "optimising needs gtsam"}
    assert summary["state"] == "complete"
    assert not (tmp_path / "trajectory_optimized_tum.txt").exists()
