"""One bag through `replay_bag`: every mode leaves every file, they agree with each other, and twice is the same."""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from descriptor_packages import write_package
from places import PROJECT_ROOT
from replay_cases import (
    CONFIG,
    KNOWN,
    OUTPUTS,
    OUTPUTS_OF,
    STAMPS,
    WAY,
    StopAfter,
    job,
    read_decisions,
    replay_in_all_modes,
    timeless_lines,
    write_reference,
    write_room_bag,
)
from yardstick import Stopwatch

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import ConfigError, InputError, MissingDependencyError
from svc_ros.evaluation.bag_reference import MAX_ROTATION_DEG, MAX_TRANSLATION_M
from svc_ros.io.bags import Bag, CloudBagWriter
from svc_ros.io.bags.result_writer import PICTURE_TOPICS, RESULT_TOPICS
from svc_ros.io.config_yaml import read_config
from svc_ros.io.g2o import read_g2o
from svc_ros.io.trajectories import read_tum
from svc_ros.replay import run as replay_run
from svc_ros.replay.job import MODES, ReplayJob
from svc_ros.replay.run import replay_bag

NUM_DECISIONS = {"pair": 6, "scan_matching": 7, "loop_closure": 3, "localization": 7}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room_bag(tmp_path_factory.mktemp("run") / "room")


@pytest.fixture(scope="module")
def runs(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return replay_in_all_modes(bag, tmp_path_factory.mktemp("out"))


def summary_of(out: Path) -> dict[str, Any]:
    return json.loads((out / "summary.json").read_text())


def mcap_counts(path: Path) -> dict[str, int]:
    """Messages by topic, counted by the mcap library one by one."""
    reader = pytest.importorskip("mcap.reader")
    with path.open("rb") as file:
        messages = reader.make_reader(file, validate_crcs=True).iter_messages()
        return Counter(channel.topic.rpartition("/")[2] for _, channel, _ in messages)


@pytest.mark.parametrize("mode", MODES)
def test_every_mode_leaves_every_file(runs: dict[str, Path], mode: str) -> None:
    out = runs[mode]
    assert {path.name for path in out.iterdir()} == OUTPUTS_OF[mode]
    rows, summary = read_decisions(out), summary_of(out)
    assert len(rows) == NUM_DECISIONS[mode]
    assert (summary["state"], summary["interrupted"]) == ("complete", False)
    assert (summary["num_scans"], summary["num_decisions"]) == (len(WAY), len(rows))
    assert {k: v for k, v in summary["verdicts"].items() if v} == Counter(row["verdict"] for row in rows)
    assert summary["reasons"] == Counter(row["reason"] for row in rows)
    assert summary["recorded_s"] == pytest.approx(0.6)
    assert summary["real_time_factor"] == pytest.approx(0.6 / summary["wall_time_s"])
    total = summary["latency_ms"]["total"]
    timed = [row["time_ms"]["total"] for row in rows if row["origin"] != "start"]  # the first scan is not judged
    assert total["median"] == pytest.approx(np.median(timed))
    assert total["median"] <= total["p95"]
    assert summary["versions"]["rosbags"]
    assert read_config(out / "config.yaml", preset("lidar_outdoor")) == CONFIG


@pytest.mark.parametrize("mode", MODES)
def test_the_recorded_results_tell_of_every_decision(runs: dict[str, Path], mode: str) -> None:
    out = runs[mode]
    rows = read_decisions(out)
    accepted = [row for row in rows if row["verdict"] == "accepted"]
    expected = {"decision": len(rows), "rejected": len(rows), "transform": len(accepted), "pose": len(accepted)}
    judged = [row for row in rows if row["evidence"]]
    expected |= {"sight_lines": len(judged), "blocked_points": len(judged)}
    expected["aligned"] = len([row for row in judged if row["verdict"] == "accepted"])
    assert mcap_counts(out / "results.mcap") == expected
    with Bag(out / "results.mcap") as recorded:
        assert {t.name.rpartition("/")[2]: t.count for t in recorded.topics} == expected


@pytest.mark.parametrize("mode", MODES)
def test_twice_gives_the_same_decisions(runs: dict[str, Path], bag: Path, tmp_path: Path, mode: str) -> None:
    reference = runs[mode].parent / "reference.txt"
    replay_bag(job(bag, tmp_path / mode, mode, reference=reference))
    assert timeless_lines(tmp_path / mode) == timeless_lines(runs[mode])
    for name in ("trajectory_tum.txt", "loops.g2o", "config.yaml"):
        assert (tmp_path / mode / name).read_bytes() == (runs[mode] / name).read_bytes()


@pytest.mark.parametrize("mode", MODES)
def test_the_trajectory_is_the_way(runs: dict[str, Path], mode: str) -> None:
    trajectory = read_tum(runs[mode] / "trajectory_tum.txt")
    assert trajectory.stamps_ns.tolist() == STAMPS
    for found, expected in zip(trajectory.poses, WAY, strict=True):
        angle, distance = se3.pose_error(found, se3.invert(WAY[0]) @ expected)
        assert angle < 1.0
        assert distance < 0.05


def test_graphs_hold_what_was_accepted(runs: dict[str, Path]) -> None:
    graphs = {mode: read_g2o(out / "loops.g2o") for mode, out in runs.items()}
    num_poses = {mode: len(graph.poses) for mode, graph in graphs.items()}
    assert num_poses == {**dict.fromkeys(MODES, len(WAY)), "localization": len(WAY) + len(KNOWN)}
    placed = [(e.source, e.target - len(WAY)) for e in graphs["localization"].edges]
    assert placed == [(row["source_index"], row["target_index"]) for row in read_decisions(runs["localization"])]
    assert [(e.source, e.target) for e in graphs["pair"].edges] == [(k + 1, k) for k in range(6)]
    assert len(graphs["scan_matching"].edges) == 6  # the first scan is linked with nothing
    loops = [(e.source, e.target) for e in graphs["loop_closure"].edges[6:]]
    rows = read_decisions(runs["loop_closure"])
    assert loops == [(row["source_index"], row["target_index"]) for row in rows if row["verdict"] == "accepted"]


@pytest.mark.parametrize("mode", MODES)
def test_errors_against_the_reference(runs: dict[str, Path], mode: str) -> None:
    summary, rows = summary_of(runs[mode]), read_decisions(runs[mode])
    reference = summary["reference"]
    assert reference["num_false_accepted"] == 0
    assert summary.get("false_loops", 0) == 0
    assert ("false_loops" in summary) == (mode == "loop_closure")
    assert reference["num_poses_compared"] == len(WAY)
    assert reference["ape"]["translation_m"]["rmse"] < 0.03
    assert reference["rpe"]["rotation_deg"]["max"] < 1.0
    compared = [row for row in rows if row["origin"] != "start" and row["verdict"] == "accepted"]
    assert reference["num_accepted_compared"] == len(compared)
    assert reference["translation_error_m"]["max"] == max(row["translation_error_m"] for row in compared)


def test_decisions_tell_indices_origin_and_place(runs: dict[str, Path]) -> None:
    (start, second, *_) = read_decisions(runs["scan_matching"])
    assert (start["origin"], start["source_index"], start["target_index"]) == ("start", 0, 0)
    assert np.array_equal(start["T_odom_source"], np.eye(4))
    assert (second["origin"], second["source_index"], second["target_index"]) == ("motion", 1, 0)
    assert second["source_stamp_ns"] == STAMPS[1]
    loops = read_decisions(runs["loop_closure"])
    assert {row["origin"] for row in loops} == {"odometry"}
    assert all(row["source_stamp_ns"] == STAMPS[row["source_index"]] for row in loops)
    assert all(row["target_stamp_ns"] == STAMPS[row["target_index"]] for row in loops)


def test_a_wrong_loop_is_counted(bag: Path, tmp_path: Path, runs: dict[str, Path]) -> None:
    lines = (runs["pair"].parent / "reference.txt").read_text().splitlines()
    words = lines[-1].split()
    lines[-1] = " ".join([words[0], str(float(words[1]) + 1.0), *words[2:]])  # the last scan stood elsewhere
    (tmp_path / "reference.txt").write_text("\n".join(lines) + "\n")
    summary = replay_bag(job(bag, tmp_path / "out", "loop_closure", reference=tmp_path / "reference.txt"))
    assert summary["false_loops"] == 1
    assert summary["reference"]["num_false_accepted"] == 1


def test_odometry_of_the_bag_takes_the_place_of_scan_matching(bag: Path, tmp_path: Path) -> None:
    summary = replay_bag(job(bag, tmp_path, "loop_closure", odometry_frame="odom"))
    assert summary["num_decisions"] == 3
    poses = read_tum(tmp_path / "trajectory_tum.txt").poses
    np.testing.assert_allclose(poses, WAY, atol=1e-9)
    with pytest.raises(InputError, match=r"--odometry-frame mast.*base_link"):
        replay_bag(job(bag, tmp_path / "else", "loop_closure", odometry_frame="mast"))
    assert not (tmp_path / "else").exists()


def test_a_part_of_the_bag(bag: Path, tmp_path: Path) -> None:
    replay_bag(job(bag, tmp_path / "part", start_s=0.2, duration_s=0.25))
    rows = read_decisions(tmp_path / "part")
    assert [row["target_stamp_ns"] for row in rows] == [STAMPS[2], STAMPS[3]]
    assert [(row["source_index"], row["target_index"]) for row in rows] == [(1, 0), (2, 1)]
    with pytest.raises(InputError, match=r"0\.6 s, and is to start at 10 s"):
        replay_bag(job(bag, tmp_path / "beyond", start_s=10.0))


def test_strides(bag: Path, tmp_path: Path) -> None:
    replay_bag(job(bag, tmp_path / "pair", stride=3))
    assert [(r["source_index"], r["target_index"]) for r in read_decisions(tmp_path / "pair")] == [
        (3, 0), (4, 1), (5, 2), (6, 3)
    ]  # fmt: skip
    replay_bag(job(bag, tmp_path / "stream", "scan_matching", stride=3))
    assert [row["source_stamp_ns"] for row in read_decisions(tmp_path / "stream")] == [STAMPS[0], STAMPS[3], STAMPS[6]]


def test_broken_scans_are_decisions_and_split_the_trajectory(tmp_path: Path) -> None:
    bag = write_room_bag(tmp_path / "bag", broken=(3,))
    summary = replay_bag(job(bag, tmp_path / "out"))
    assert summary["reasons"] == {"ok": 4, "too_few_points": 2}
    assert summary["trajectory"] == {"num_poses": 3, "num_parts": 2}
    assert read_tum(tmp_path / "out" / "trajectory_tum.txt").stamps_ns.tolist() == STAMPS[:3]


def test_input_may_be_copied(bag: Path, tmp_path: Path) -> None:
    replay_bag(job(bag, tmp_path / "out", with_input=True))
    with Bag(tmp_path / "out" / "results.mcap") as results, Bag(bag) as recorded:
        counts = {topic.name: topic.count for topic in results.topics}
        assert counts["/points"] == len(WAY)
        assert (counts["/tf"], counts["/tf_static"]) == (len(WAY), 1)
        for (first_ns, first), (second_ns, second) in zip(
            results.raw_clouds("/points"), recorded.raw_clouds("/points"), strict=True
        ):
            assert first_ns == second_ns
            assert np.array_equal(first.data, second.data)
        np.testing.assert_allclose(results.transforms().lookup("odom", "lidar", STAMPS[4]), WAY[4], atol=1e-9)


class SleepingClock:
    """A clock on which nothing but sleeping takes time."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.mark.parametrize(("rate", "slept"), [(10.0, 0.7), (2.0, 3.5), (None, 0.0)])
def test_the_rate_is_kept(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: float | None, slept: float
) -> None:
    clock = SleepingClock()
    monkeypatch.setattr(replay_run, "time", clock)
    replay_bag(job(bag, tmp_path, "loop_closure", max_rate_hz=rate, odometry_frame="odom"))
    assert clock.now - 100.0 == pytest.approx(slept)


def test_progress_ends_where_the_bag_does(bag: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    replay_bag(job(bag, tmp_path, start_s=0.2), on_progress=lambda done, total: seen.append((done, total)))
    assert [done for done, _ in seen] == [1, 2, 3, 4, 5, 5]
    assert seen[-1] == (5, 5)


@pytest.mark.parametrize("mode", MODES)
def test_an_interrupted_replay_has_complete_outputs(bag: Path, tmp_path: Path, mode: str) -> None:
    summary = replay_bag(job(bag, tmp_path, mode), should_stop=StopAfter(4))
    assert {path.name for path in tmp_path.iterdir()} == OUTPUTS_OF[mode]
    assert (summary["state"], summary["interrupted"], summary["num_scans"]) == ("interrupted", True, 4)
    rows = read_decisions(tmp_path)
    assert len(rows) == summary["num_decisions"]
    assert mcap_counts(tmp_path / "results.mcap")["decision"] == len(rows)
    assert len(read_tum(tmp_path / "trajectory_tum.txt")) == 4


def test_a_topic_without_clouds_leaves_nothing(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"/lidar.*/points"):
        replay_bag(job(bag, tmp_path / "out", topic="/lidar"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("mode", MODES)
def test_a_bag_that_breaks_off_leaves_what_was_decided(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    def breaking(self: Bag, *arguments: Any) -> Iterator[tuple[int, Any]]:
        yield from itertools.islice(original(self, *arguments), 5)
        raise InputError("room: cannot be read as a bag: it is truncated")

    original = Bag.raw_clouds
    monkeypatch.setattr(Bag, "raw_clouds", breaking)
    with pytest.raises(InputError, match="it is truncated"):
        replay_bag(job(bag, tmp_path, mode))
    monkeypatch.undo()
    assert {path.name for path in tmp_path.iterdir()} == OUTPUTS_OF[mode]
    summary, rows = summary_of(tmp_path), read_decisions(tmp_path)
    assert (summary["state"], summary["num_scans"]) == ("failed", 5)
    assert "truncated" in summary["error"]
    assert len(rows) == summary["num_decisions"] > 0
    assert mcap_counts(tmp_path / "results.mcap")["decision"] == len(rows)
    assert len(read_tum(tmp_path / "trajectory_tum.txt")) == 5


def test_a_bag_without_messages_is_refused_and_one_without_clouds_is_not(tmp_path: Path) -> None:
    with CloudBagWriter(tmp_path / "empty"):
        pass
    with pytest.raises(InputError, match="found none"):
        replay_bag(job(tmp_path / "empty", tmp_path / "out"))
    part = job(write_room_bag(tmp_path / "room"), tmp_path / "out", start_s=0.05, duration_s=0.01)
    summary = replay_bag(dataclasses.replace(part, report=True))
    assert (summary["num_scans"], summary["num_decisions"], summary["real_time_factor"]) == (0, 0, 0.0)
    assert read_decisions(tmp_path / "out") == []


def test_the_page_names_what_there_is(runs: dict[str, Path], bag: Path, tmp_path: Path) -> None:
    """docs/replay.md: files, keys of the summary, topics, options."""
    page = (PROJECT_ROOT / "docs" / "replay.md").read_text("utf-8")
    tables = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"]
    named = {name for row in tables for name in re.findall(r"`([^`]+)`", row[0])}
    chosen = replay_bag(dataclasses.replace(job(bag, tmp_path / "auto"), preset="auto"))
    summaries = [chosen, *(summary_of(out) for out in runs.values())]
    files = OUTPUTS_OF["loop_closure"] | {"report.html", "trajectory_optimized_tum.txt"}  # the last one with an extra
    known = {name for summary in summaries for name in summary} | set(MODES) | files
    done = subprocess.run([sys.executable, "-m", "svc_ros", "replay", "--help"], capture_output=True, text=True)
    options = {name.partition(" ")[0] for name in named if name.startswith("--")}
    assert options
    assert {name for name in options if name not in done.stdout} == set()
    assert {name for name in named if not name.startswith("--")} - known == set()
    assert files | set(MODES) <= named
    topics = {*RESULT_TOPICS, *PICTURE_TOPICS}
    assert all(f"`{topic}`" in page for topic in topics)
    assert "more than 5 deg or 0.6 m" in page
    assert (MAX_ROTATION_DEG, MAX_TRANSLATION_M) == (5.0, 0.6)


@pytest.mark.parametrize(
    ("missing", "values", "message"),
    [
        ("plotly", {"report": True}, "pip install plotly, or replay with --no-report"),
        ("evo", {"reference": Path("reference.txt")}, "pip install 'evo"),
    ],
)
def test_what_is_not_installed_is_said_before_the_work(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str, values: dict[str, Any], message: str
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else found(name))
    if missing == "evo":
        monkeypatch.setitem(sys.modules, "evo.core.metrics", None)
        monkeypatch.chdir(write_reference(tmp_path / "reference.txt").parent)
    with pytest.raises(MissingDependencyError, match=message):
        replay_bag(job(bag, tmp_path / "out", **values))
    assert not (tmp_path / "out").exists()


def test_a_descriptor_that_cannot_be_used_is_told_before_the_work(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, "incomplete", "import not_installed_anywhere", incomplete="describe")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, error in (("incomplete", MissingDependencyError), ("unknown", ConfigError)):
        config = with_values(CONFIG, {"matching.more_descriptors": name})
        with pytest.raises(error, match=name):
            replay_bag(dataclasses.replace(job(bag, tmp_path / "out"), config=config))
    assert not (tmp_path / "out").exists()


def test_the_report_is_beside_the_rest(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    summary = replay_bag(job(bag, tmp_path, duration_s=0.25, report=True))
    assert {path.name for path in tmp_path.iterdir()} == OUTPUTS | {"report.html"}
    assert "<html" in (tmp_path / "report.html").read_text("utf-8")[:1000].lower()
    assert summary["report_time_s"] > 0.0
    assert summary_of(tmp_path) == summary


@pytest.mark.parametrize("mode", ["pair", "scan_matching"])
def test_a_real_walk_in_both_generations_of_bags(shared_data: Path, tmp_path: Path, mode: str) -> None:
    """ROS 1 (LZ4) and ROS 2 (zstd): the same clouds, the same decisions."""
    folder = shared_data / "bags" / "os0_64_walk"
    for name in ("ros1_first22.bag", "ros2_mcap"):
        part = ReplayJob(
            folder / name, tmp_path / name, preset("lidar_indoor"), mode=mode, start_s=4.0, duration_s=4.0,
            reference=folder / "reference_tum.txt", with_input=True, report=False,
        )  # fmt: skip
        summary = replay_bag(part)
        assert summary["num_scans"] == 4
        assert summary["verdicts"]["accepted"] == (3 if mode == "pair" else 4)
        assert summary["reference"]["num_false_accepted"] == 0
        counts = mcap_counts(tmp_path / name / "results.mcap")
        assert (counts["points"], counts["tf"]) == (4, 4)
    assert timeless_lines(tmp_path / "ros1_first22.bag") == timeless_lines(tmp_path / "ros2_mcap")


@pytest.mark.slow
def test_the_whole_walk_in_time_and_without_a_false_loop(shared_data: Path, tmp_path: Path) -> None:
    """88 s of bag in at most 60 s on two cores, report included."""
    folder = shared_data / "bags" / "os0_64_walk"
    walk = ReplayJob(
        folder / "ros2_mcap", tmp_path / "first", preset("lidar_outdoor"), mode="loop_closure",
        reference=folder / "reference_tum.txt",
    )  # fmt: skip
    with Stopwatch() as watch:
        summary = replay_bag(walk)
    assert watch.own_s < 60.0, watch
    assert summary["false_loops"] == 0
    assert summary["verdicts"]["accepted"] >= 20
    assert summary["real_time_factor"] > 88.0 / (60.0 + watch.others_s)
    assert (tmp_path / "first" / "report.html").stat().st_size < 15_000_000
    replay_bag(dataclasses.replace(walk, out=tmp_path / "second", report=False))
    assert timeless_lines(tmp_path / "first") == timeless_lines(tmp_path / "second")

