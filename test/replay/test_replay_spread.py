"""Several bags over Dask: the decisions of the serial replay, bags that cannot be read, a worker that is lost."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import dask_processes
import pytest
from typer.testing import CliRunner

from svc_ros.cli.main import app
from svc_ros.core.config import preset
from svc_ros.core.errors import InputError
from svc_ros.replay.job import ReplayJob
from svc_ros.replay.spread import replay_over
from svc_ros.simulation.drive import DriveConfig, simulate_drive

pytest.importorskip("distributed")
OPTIONS = ("--preset", "lidar_indoor", "--no-report")


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    found = []
    for seed in range(3):
        config = DriveConfig(scene="indoor", sensor="OS1-64", num_scans=3, seed=seed)
        found.append(simulate_drive(folder / f"run{seed}", config).bag)
    return found


@pytest.fixture(scope="module")
def workers(tmp_path_factory):
    with dask_processes.cluster(tmp_path_factory.mktemp("dask")) as found:
        yield found


def replay(*words: str | Path, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["replay", *map(str, words), *OPTIONS])
    assert result.exit_code == code, result.output
    return result.output


def decisions(folder: Path) -> dict[str, list[dict]]:
    """Records by the bag's folder, times aside."""
    found = {}
    for path in sorted(folder.rglob("decisions.jsonl")):
        records = [json.loads(line) for line in path.read_text().splitlines()]
        for record in records:
            del record["time_ms"]
        found[str(path.parent.relative_to(folder))] = records
    return found


@pytest.mark.slow
def test_bags_over_workers_give_the_decisions_of_the_serial_replay(bags, workers, tmp_path):
    replay(*bags, "--out", tmp_path / "serial")
    text = replay(*bags, "--out", tmp_path / "spread", "--scheduler", workers.address)
    serial, spread = decisions(tmp_path / "serial"), decisions(tmp_path / "spread")
    assert spread == serial
    assert [len(records) for records in serial.values()] == [2, 2, 2]
    assert "3 of 3 bags" in text
    summaries = [json.loads((tmp_path / name / "summary.json").read_text()) for name in ("serial", "spread")]
    for name in ("num_scans", "num_decisions", "verdicts", "reasons", "num_failed", "num_not_begun"):
        assert summaries[1][name] == summaries[0][name]


def test_one_bag_leaves_its_outputs_in_the_folder_itself(bags, workers, tmp_path):
    replay(bags[0], "--out", tmp_path, "--scheduler", workers.address)
    assert json.loads((tmp_path / "summary.json").read_text())["state"] == "complete"
    assert list(decisions(tmp_path)) == ["."]


def test_a_bag_that_cannot_be_read_does_not_keep_the_others(bags, workers, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag")
    text = replay(bags[0], broken, "--out", tmp_path / "out", "--scheduler", workers.address, code=2)
    assert "1 of 2 bags could not be replayed" in text
    assert "broken.mcap" in text
    runs = json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]
    assert [run["state"] for run in runs] == ["complete", "failed"]


@pytest.mark.slow
def test_bags_of_a_lost_worker_are_replayed_by_another(bags, tmp_path):
    jobs = [
        ReplayJob(bag, tmp_path / f"{k}", preset("lidar_indoor"), "lidar_indoor", report=False)
        for k, bag in enumerate([*bags, *bags])
    ]
    told = []
    with dask_processes.cluster(tmp_path) as found:

        def kill_one(done: int, total: int) -> None:
            told.append((done, total))
            if done == 1:
                os.kill(found.workers[0].pid, signal.SIGKILL)

        done = replay_over(found.address, jobs, kill_one)
        assert found.workers[0].wait() == -signal.SIGKILL
    assert told == [(k, 6) for k in range(1, 7)]
    assert (done.errors, done.interrupted, set(done.summaries)) == ({}, False, {job.out for job in jobs})
    records = decisions(tmp_path)
    for k in range(3):
        assert records[f"{k}"] == records[f"{k + 3}"]


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_done(bags, workers, tmp_path):
    jobs = [ReplayJob(bag, tmp_path / bag.parent.name, preset("lidar_indoor"), report=False) for bag in bags]

    def interrupt(done: int, _: int) -> None:
        raise KeyboardInterrupt

    done = replay_over(workers.address, jobs, interrupt)
    assert done.interrupted
    assert len(done.summaries) == 1


@pytest.mark.slow
def test_folders_that_cannot_be_made_are_told_before_the_work(bags, workers, tmp_path):
    (tmp_path / "file").write_text("")
    job = ReplayJob(bags[0], tmp_path / "file" / "below", preset("lidar_indoor"))
    with pytest.raises(InputError, match=r"--out .*below: cannot be created"):
        replay_over(workers.address, [job])
