"""An interrupted replay is continued to the same decisions, or refused where it is another one."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from replay_cases import (
    CONFIG,
    OUTPUTS_OF,
    WAY,
    StopAfter,
    job,
    read_decisions,
    replay_in_all_modes,
    timeless_lines,
    write_reference,
    write_room_bag,
)

from svc_ros.core.config import with_values
from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.pipeline import loop_closure
from svc_ros.replay import known as replay_known
from svc_ros.replay import run as replay_run
from svc_ros.replay import stream_pairs as replay
from svc_ros.replay.run import replay_bag

MODES_AND_STOPS = [("pair", 4), ("scan_matching", 3), ("loop_closure", 6), ("localization", 3)]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("resume") / "room")


@pytest.fixture(scope="module")
def whole(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Uninterrupted runs."""
    return replay_in_all_modes(bag, tmp_path_factory.mktemp("whole"))


def counts(path: Path) -> dict[str, int]:
    with Bag(path) as recorded:
        return {topic.name: topic.count for topic in recorded.topics}


def assert_same(out: Path, whole: Path) -> None:
    assert {path.name for path in out.iterdir()} == OUTPUTS_OF[whole.name]
    assert timeless_lines(out) == timeless_lines(whole)
    for name in ("trajectory_tum.txt", "loops.g2o", "config.yaml"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert counts(out / "results.mcap") == counts(whole / "results.mcap")
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (out, whole)]
    for name in ("state", "num_scans", "num_decisions", "verdicts", "reasons", "trajectory", "graph", "reference"):
        assert summaries[0][name] == summaries[1][name]


@pytest.mark.parametrize(("mode", "num_scans"), MODES_AND_STOPS)
def test_a_continued_run_is_the_uninterrupted_one(
    bag: Path, whole: dict[str, Path], tmp_path: Path, mode: str, num_scans: int
) -> None:
    wanted = job(bag, tmp_path, mode, reference=whole[mode].parent / "reference.txt")
    replay_bag(wanted, should_stop=StopAfter(num_scans))
    before = read_decisions(tmp_path)
    assert 0 < len(before) < len(read_decisions(whole[mode]))
    replay_bag(dataclasses.replace(wanted, resume=True))
    assert_same(tmp_path, whole[mode])
    assert read_decisions(tmp_path)[: len(before)] == before  # with the times that they took then


@pytest.mark.parametrize(
    ("mode", "num_scans"),
    [each if each[0] == "loop_closure" else pytest.param(*each, marks=pytest.mark.slow) for each in MODES_AND_STOPS],
)
def test_a_killed_run_is_continued_from_its_last_whole_line(
    bag: Path, whole: dict[str, Path], tmp_path: Path, mode: str, num_scans: int
) -> None:
    wanted = job(bag, tmp_path, mode, reference=whole[mode].parent / "reference.txt")
    replay_bag(wanted, should_stop=StopAfter(num_scans))
    (tmp_path / "results.mcap").unlink()
    (tmp_path / ".results-1234.unfinished" / "bag").mkdir(parents=True)
    lines = (tmp_path / "decisions.jsonl").read_text()
    (tmp_path / "decisions.jsonl").write_text(lines + '{"source_stamp_ns": 17')
    replay_bag(dataclasses.replace(wanted, resume=True))
    assert_same(tmp_path, whole[mode])


def test_pairs_and_loops_are_not_registered_again(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def counting(function: Any) -> Any:
        def wrapper(*arguments: Any, **more: Any) -> Any:
            asked.append(1)
            return function(*arguments, **more)

        return wrapper

    replay_bag(job(bag, tmp_path / "pair"), should_stop=StopAfter(5))
    replay_bag(job(bag, tmp_path / "loops", "loop_closure"), should_stop=StopAfter(6))
    num_loops = len(read_decisions(tmp_path / "loops"))
    monkeypatch.setattr(replay, "register_pair", counting(replay.register_pair))
    monkeypatch.setattr(replay_known, "judge_candidate", counting(loop_closure.judge_candidate))
    replay_bag(job(bag, tmp_path / "pair", resume=True))
    assert len(asked) == len(WAY) - 1 - 4
    asked.clear()
    replay_bag(job(bag, tmp_path / "loops", "loop_closure", resume=True))
    assert len(asked) == len(read_decisions(tmp_path / "loops")) - num_loops > 0


def test_continuing_twice_loses_nothing(bag: Path, whole: dict[str, Path], tmp_path: Path) -> None:
    """Also where the second run is interrupted before it comes to what the first one had decided."""
    wanted = job(bag, tmp_path, reference=whole["pair"].parent / "reference.txt")
    replay_bag(wanted, should_stop=StopAfter(6))
    again = dataclasses.replace(wanted, resume=True)
    summary = replay_bag(again, should_stop=StopAfter(2))
    assert (summary["state"], summary["num_decisions"], len(read_decisions(tmp_path))) == ("interrupted", 5, 5)
    assert counts(tmp_path / "results.mcap")["/svc_registration/decision"] == 5
    replay_bag(again)
    assert_same(tmp_path, whole["pair"])


def test_what_is_complete_is_left_alone(bag: Path, tmp_path: Path) -> None:
    first = replay_bag(job(bag, tmp_path, duration_s=0.15))
    stamps = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert replay_bag(job(bag, tmp_path, duration_s=0.15, resume=True)) == first
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == stamps


def test_without_an_earlier_run_it_begins(bag: Path, tmp_path: Path) -> None:
    summary = replay_bag(job(bag, tmp_path / "new", duration_s=0.15, resume=True))
    assert (summary["state"], summary["num_decisions"]) == ("complete", 1)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mode": "loop_closure"}, "another mode: 'pair', found 'loop_closure'"),
        ({"stride": 2}, "another stride"),
        ({"start_s": 0.1}, "another start_s"),
        ({"config": with_values(CONFIG, {"preprocess.voxel_size_m": 0.31})}, "another configuration: see"),
    ],
)
def test_another_run_is_not_continued(bag: Path, tmp_path: Path, change: dict[str, Any], named: str) -> None:
    first = job(bag, tmp_path)
    replay_bag(first, should_stop=StopAfter(3))
    lines = (tmp_path / "decisions.jsonl").read_bytes()
    with pytest.raises(InputError, match=named):
        replay_bag(dataclasses.replace(first, resume=True, **change))
    assert (tmp_path / "decisions.jsonl").read_bytes() == lines


def test_another_bag_or_reference_is_not_continued(bag: Path, tmp_path: Path) -> None:
    reference = write_reference(tmp_path / "reference.txt")
    replay_bag(job(bag, tmp_path / "out", reference=reference), should_stop=StopAfter(3))
    other = write_room_bag(tmp_path / "room", broken=(6,))
    with pytest.raises(InputError, match="another bag_bytes"):
        replay_bag(job(other, tmp_path / "out", resume=True, reference=reference))
    reference.write_text(reference.read_text() + "\n")
    with pytest.raises(InputError, match="another reference_sha256"):
        replay_bag(job(bag, tmp_path / "out", resume=True, reference=reference))


def test_a_decision_that_comes_out_differently_is_not_passed_over(bag: Path, tmp_path: Path) -> None:
    wanted = job(bag, tmp_path, "scan_matching")
    replay_bag(wanted, should_stop=StopAfter(4))
    rows = read_decisions(tmp_path)
    rows[2]["reason"] = "low_overlap"
    (tmp_path / "decisions.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    with pytest.raises(InputError, match=r"decision 2 has reason 'ok'.*'low_overlap'"):
        replay_bag(dataclasses.replace(wanted, resume=True))


def test_a_summary_that_is_none_is_named(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("[1]")
    with pytest.raises(InputError, match=r"summary\.json: expected a JSON object"):
        replay_bag(job(bag, tmp_path, resume=True))


def test_a_new_run_forgets_the_old_one(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a run that is killed early cannot be taken for the one whose files it found."""
    replay_bag(job(bag, tmp_path))

    def broken(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(replay_run, "steps_of", broken)
    with pytest.raises(KeyboardInterrupt):
        replay_bag(job(bag, tmp_path, "scan_matching"))
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"config.yaml", "decisions.jsonl", "summary.json", "results.mcap"}
    assert read_decisions(tmp_path) == []
    assert counts(tmp_path / "results.mcap")["/svc_registration/decision"] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["state"] == "running"
