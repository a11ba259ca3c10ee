"""The benchmark scripts on a small room: the keys that others read, and that a wrong answer is noticed before timing.

Times themselves are never looked at.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from mini_data import write_dataset
from places import BENCHMARKS

from svc_ros.core.config import with_values
from svc_ros.core.scan import HypothesisSet
from svc_ros.io.datasets import read_dataset

RUN = {
    "date": "today", "commit": "abc", "uncommitted": [], "machine": {}, "packages": {}, "config": {"lidar_indoor": {}},
}  # fmt: skip


@pytest.fixture(autouse=True)
def no_exact_times(scripts, monkeypatch):
    """Calls are not repeated for exact times."""
    from lib import timing as _timing

    monkeypatch.setattr(_timing, "_SHORT_MS", 2.0)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A folder of data sets with one room in it."""
    folder = tmp_path_factory.mktemp("pairs")
    write_dataset(folder / "room")
    return folder


@pytest.fixture(scope="module")
def room(data):
    sys.path.insert(0, str(BENCHMARKS))
    from lib import cases

    sys.path.remove(str(BENCHMARKS))
    return cases.read_case(read_dataset(data / "room"))


def run_main(script, monkeypatch, data: Path, out: Path, *options: str) -> dict:
    """Run a script as from the command line and return latest.json."""
    monkeypatch.setattr(sys, "argv", [script.__name__, "--data", str(data), "--out", str(out), *options])
    script.main()
    return json.loads((out / "latest.json").read_text())


def test_stages_measures_every_stage_and_both_twins(monkeypatch, data, tmp_path):
    import stages

    sizes = ["--points", "300", "600", "--correspondences", "100", "200", "--poses", "20", "40"]
    found = run_main(stages, monkeypatch, data, tmp_path, *sizes, "--check-at", "500", "--rounds", "1")
    check = found["svc_check"]
    for value in (check["speedup_vs_kdtree_10k"], check["paper_speedup_vs_kdtree_10k"], check["exponent"],
                  found["hypotheses"]["speedup_vs_dense_5000"], found["icp"]["speedup_vs_small_gicp"]):  # fmt: skip
        assert math.isfinite(value)
    assert (check["points"], found["hypotheses"]["correspondences"]) == (500, 200)
    assert set(found["stages"]["points"]) == {
        "voxel grid", "normals", "range image", "FPFH", "matching of all", "first matching", "first sight view",
        "sight view", "glance", "pre-scoring", "ICP", "verify",
    }  # fmt: skip
    for table, numbers in (("points", [300, 600]), ("correspondences", [100, 200]), ("hypotheses", [20, 40])):
        for stage in found["stages"][table].values():
            assert stage["number"] == numbers
            assert len(stage["time_ms"]) == 2
            assert math.isfinite(stage["exponent"])
    assert found["svc_check"]["commit"] == found["runs"]["stages"]["commit"]
    assert (tmp_path / "stages.png").stat().st_size > 0


def test_twins_answer_the_same_question_and_a_wrong_one_is_noticed(monkeypatch, room):
    from lib import checks

    pair = checks.thin_pair(room, 800)
    assert (len(pair.source), len(pair.target)) == (800, 800)
    honest = checks.look_by_trees
    for T in (room.T_target_source, room.wrong_pose):
        jobs = checks.check_jobs(pair, T)
        lines, _ = jobs[checks.TWIN]()
    assert lines.num_blocked > 10  # at the wrong pose: the comparison is of something

    def careless(observer, other, T, config):
        return honest(observer, other, T, dataclasses.replace(config, tolerance_m=1.05 * config.tolerance_m))

    monkeypatch.setattr(checks, "look_by_trees", careless)
    with pytest.raises(checks.DisagreementError):
        checks.check_jobs(pair, room.wrong_pose)


@pytest.mark.parametrize("field", ["num_lines", "num_observed", "blocked_idx", "blocker_idx"])
def test_every_part_of_the_sight_lines_is_compared(room, field):
    from lib import checks

    pair = checks.thin_pair(room, 800)
    lines, _ = checks.look_one_way(pair.target, pair.source, room.wrong_pose, pair.config.sight_view)
    checks.require_same_lines(lines, lines)
    other = dataclasses.replace(lines, **{field: getattr(lines, field) + 1})
    with pytest.raises(checks.DisagreementError):
        checks.require_same_lines(lines, other)


def test_dense_hypotheses_are_the_same_and_wrong_ones_are_noticed(monkeypatch, room):
    from lib import cases, checks

    matches = cases.correspond(room, 300)
    config = room.config.hypotheses
    ours = checks.generate_hypotheses(matches, config)
    assert len(ours) > 10
    for ranking in ("ic", "mae", "mse"):
        ranked = dataclasses.replace(config, ranking=ranking)
        checks.require_same_hypotheses(
            checks.generate_hypotheses(matches, ranked), checks.dense_hypotheses(matches, ranked)
        )
    moved = ours.T_target_source.copy()
    moved[0, 0, 3] += 1e-3
    with pytest.raises(checks.DisagreementError):
        checks.require_same_hypotheses(ours, HypothesisSet(moved, ours.num_inliers, ours.score))

    honest = checks.dense_hypotheses
    careless = with_values(room.config, {"hypotheses.compatibility_threshold_m": 0.19}).hypotheses
    monkeypatch.setattr(checks, "dense_hypotheses", lambda given, _: honest(given, careless))
    with pytest.raises(checks.DisagreementError):
        checks.compare_hypotheses(matches, config, 1)


def test_compare_judges_every_method_before_it_is_timed(monkeypatch, data, tmp_path):
    import compare
    from lib.contenders import Answer

    def right(raw):
        return lambda: Answer(True, raw.pair.T_target_source)

    def wrong(raw):
        return lambda: Answer(True, np.eye(4))

    monkeypatch.setitem(compare.CONTENDERS, "kiss_matcher", wrong)
    monkeypatch.setitem(compare.CONTENDERS, "open3d_ransac", right)
    monkeypatch.setattr(compare, "missing", dict)
    memory = {"room": {"before_mb": 1.0, "peak_mb": 7.0}}
    monkeypatch.setattr(compare, "peaks", lambda *_: memory)
    monkeypatch.setattr(compare, "choose", lambda dataset, limit: dataset.pairs[:limit])  # without the broken one
    found = run_main(compare, monkeypatch, data, tmp_path, "--limit", "2", "--rounds", "1")
    assert (found["kiss_matcher"]["recall"], found["open3d_ransac"]["recall"]) == (0.0, 1.0)
    assert found["register"]["recall"] == found["verify"]["recall"] == 1.0
    for section, key in (("register", "ratio_vs_kiss_matcher"), ("register", "ratio_vs_kiss_matcher_reused"),
                         ("verify", "ratio_vs_register"), ("verify", "ratio_vs_register_first")):  # fmt: skip
        assert found[section][key] > 0
    assert found["register"]["by_set"]["room"]["ratio_vs_kiss_matcher"] > 0
    assert found["register"]["peak_mb"] == 7.0
    assert len(found["compare"]["pairs"]) == 2 * len(compare.CONTENDERS)
    assert (tmp_path / "compare.png").stat().st_size > 0


def test_ratios_are_medians_of_the_pairs_own_ratios():
    from compare import Row, numbers

    from svc_ros.evaluation.metrics import PairOutcome

    times = {"register": (10.0, 20.0, 90.0), "kiss_matcher": (20.0, 100.0, 100.0)}
    outcome = PairOutcome(accepted=True, correct=True)
    rows = [Row("set", str(k), "t", name, outcome, ms) for name, all_ms in times.items() for k, ms in enumerate(all_ms)]
    found = numbers(rows, "register", list(times))
    assert found["ratio_vs_kiss_matcher"] == pytest.approx(0.5)
    assert (found["pairs"], found["recall"], found["time_ms_p50"]) == (3, 1.0, 20.0)


@pytest.mark.slow
def test_peak_memory_is_that_of_a_process_of_its_own(data):
    import compare
    from lib.resident import peak_mb, resident_mb

    held = np.ones((40, 1 << 20))  # 320 MB here must not show there
    found = compare.peaks("verify", [read_dataset(data / "room")])["room"]
    assert 10 < found["before_mb"] < found["peak_mb"]
    assert found["before_mb"] < 200 < resident_mb() <= peak_mb()
    assert held[-1, -1] == 1.0


def test_memory_runs_pairs_through_the_worker_of_the_node(data):
    import memory
    from lib.common import config_of

    dataset = read_dataset(data / "room")
    drive = memory.read_drive(dataset)
    samples, verdicts = memory.measure(drive, config_of(dataset), 4, 60.0)
    assert len(samples) == 5
    assert sum(verdicts.values()) == 4
    assert verdicts.get("accepted", 0) >= 2  # the guesses are right, so that pairs are verified and not only refused


def test_growth_is_the_slope_after_the_warm_up():
    import memory

    steady = np.concatenate([[100.0], np.linspace(100, 300, 40), 300 + 0.05 * np.arange(60)])
    found = memory.fit(steady)
    assert (found["pairs"], found["warm_up_pairs"]) == (100, 40)
    assert found["slope_mb_per_1000_pairs"] == pytest.approx(50.0)


def test_sections_of_other_scripts_stay(tmp_path):
    from lib.latest import record

    record(tmp_path, "one", RUN, {"a": {"value": 1}, "b": {"value": 2}})
    record(tmp_path, "two", {**RUN, "commit": "def"}, {"b": {"value": 3}})
    found = json.loads((tmp_path / "latest.json").read_text())
    assert (found["a"]["value"], found["a"]["commit"], found["a"]["presets"]) == (1, "abc", ["lidar_indoor"])
    assert (found["b"]["value"], found["b"]["commit"], found["b"]["run"]) == (3, "def", "two")
    assert set(found["runs"]) == {"one", "two"}


def test_calls_take_turns_and_the_first_one_changes():
    from lib import timing as _timing

    called: list[str] = []
    jobs = {name: (lambda name=name: called.append(name)) for name in "abc"}
    times = _timing.time_in_turns(jobs, 2)
    assert {name: len(values) for name, values in times.items()} == {"a": 2, "b": 2, "c": 2}
    assert [called[k] for k in range(3)] == ["a", "b", "c"]
    assert _timing.rotated("abc", 4) == ["b", "c", "a"]
    called.clear()
    _timing.time_in_turns(jobs, 2, calls=5)
    assert {name: called.count(name) for name in jobs} == dict.fromkeys("abc", 1 + 2 * 5)


def test_exponent_is_the_slope_of_the_logarithms():
    from lib import timing as _timing

    assert _timing.exponent([10, 20, 40], [3.0, 12.0, 48.0]) == pytest.approx(2.0)
    with pytest.raises(ValueError, match="two numbers"):
        _timing.exponent([10], [1.0])


def test_help_of_the_command_line_is_what_cold_start_times():
    import cold_start

    assert cold_start.start_help() > 0
