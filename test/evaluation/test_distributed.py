"""Work over Dask: the same answers as one after the other, workers that are lost, and workers that cannot do it."""

from __future__ import annotations

import json
import os
import signal
import sys
from functools import partial
from pathlib import Path

import dask_processes
import mini_data
import pytest

from svc_ros.core.config import preset
from svc_ros.core.errors import InputError, MissingDependencyError, SvcError
from svc_ros.evaluation import distributed as over
from svc_ros.evaluation.distributed import LOCAL, run_over
from svc_ros.evaluation.runner import evaluate_dataset
from svc_ros.io.datasets import read_dataset

pytest.importorskip("distributed")
CONFIG = preset("lidar_indoor")


@pytest.fixture(scope="module")
def pair_of_workers(tmp_path_factory):
    with dask_processes.cluster(tmp_path_factory.mktemp("dask")) as found:
        yield found


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    return mini_data.write_dataset(tmp_path_factory.mktemp("evaluation") / "room")


def many_pairs(room: Path, times: int) -> Path:
    """The room with its right pairs so many times."""
    content = json.loads((room / "dataset.json").read_text())
    content["pairs"] = content["pairs"][:2] * times
    folder = room.parent / f"room{times}"
    folder.mkdir()
    (folder / "dataset.json").write_text(json.dumps(content))
    (folder / "scans").symlink_to(room / "scans")
    return folder


def test_answers_come_in_order_and_every_item_is_told_once(pair_of_workers):
    told: list[tuple[int, int]] = []
    answers = run_over(pair_of_workers.address, dask_processes.double, range(20), lambda *one: told.append(one))
    assert answers == list(range(0, 40, 2))
    assert sorted(told) == list(enumerate(answers))


def test_kernels_of_a_worker_use_one_thread(pair_of_workers):
    assert run_over(pair_of_workers.address, dask_processes.count_threads, range(4)) == [{1}] * 4


def test_the_error_of_the_first_item_in_order_is_raised(pair_of_workers):
    with pytest.raises(ValueError, match=r"^number 3$"):
        run_over(pair_of_workers.address, dask_processes.refuse_some, [0, 1, 3, 4, 5, 6, 7])


def test_nothing_to_do_needs_no_scheduler():
    assert run_over("tcp://127.0.0.1:1", dask_processes.double, []) == []


@pytest.mark.slow
def test_local_workers_give_the_report_of_the_serial_run(room):
    progress = []
    serial = evaluate_dataset(read_dataset(room), CONFIG)
    crew = partial(run_over, LOCAL, paths=[room])
    spread = evaluate_dataset(read_dataset(room), CONFIG, None, crew, lambda *counts: progress.append(counts))
    assert mini_data.without_times(spread) == mini_data.without_times(serial)
    assert progress == [(k, 5) for k in range(1, 6)]


def test_ctrl_c_is_the_parents_to_answer():
    assert run_over(LOCAL, dask_processes.interrupt_is_ignored, [0]) == [True]


def test_a_broken_scan_is_told_as_in_the_serial_run(room, tmp_path, pair_of_workers):
    content = json.loads((room / "dataset.json").read_text())
    whole = {"source": str(room / "scans/1.bin"), "target": str(room / "scans/0.bin")}
    content["pairs"] = [content["pairs"][0] | whole]
    content["pairs"] += [content["pairs"][0] | {"source": f"scans/gone{k}.bin"} for k in range(8)]
    (tmp_path / "dataset.json").write_text(json.dumps(content))
    texts = []
    for workers in (1, partial(run_over, pair_of_workers.address)):
        with pytest.raises(InputError) as raised:
            evaluate_dataset(read_dataset(tmp_path), CONFIG, None, workers)
        texts.append(str(raised.value))
    assert texts[0] == texts[1]
    assert "gone0.bin" in texts[0]


@pytest.mark.slow
def test_what_a_killed_worker_had_to_do_is_done_by_another(room, tmp_path):
    dataset = read_dataset(many_pairs(room, 12))
    serial = evaluate_dataset(dataset, CONFIG)
    with dask_processes.cluster(tmp_path) as found:
        victim = found.workers[0]

        def kill_one(done: int, total: int) -> None:
            if victim.poll() is None and done < total:
                os.kill(victim.pid, signal.SIGKILL)
                victim.wait()

        spread = evaluate_dataset(dataset, CONFIG, None, partial(run_over, found.address), kill_one)
        assert victim.returncode == -signal.SIGKILL
        assert found.workers[1].poll() is None
    assert mini_data.without_times(spread) == mini_data.without_times(serial)


def test_a_worker_lost_in_the_middle_of_an_item_loses_nothing(tmp_path):
    with dask_processes.cluster(tmp_path) as found:
        victim, told = found.workers[0], []

        def kill_one(index: int, _: object) -> None:
            told.append(index)
            if len(told) == 5:
                os.kill(victim.pid, signal.SIGKILL)

        answers = run_over(found.address, dask_processes.double_slowly, range(30), kill_one)
    assert [number for number, _ in answers] == list(range(0, 60, 2))
    assert sorted(told) == list(range(30))
    assert answers[-1][1] == found.workers[1].pid


def test_an_item_that_takes_its_workers_down_is_given_up(tmp_path):
    with dask_processes.cluster(tmp_path, num_workers=5) as found, pytest.raises(SvcError, match="item 2 was given up"):
        run_over(found.address, dask_processes.die, range(6))


def test_data_that_the_workers_do_not_have_is_told_with_its_path(pair_of_workers, tmp_path):
    with pytest.raises(InputError, match=r"worker tcp://\S+: expected the data at \S+/nowhere, found nothing"):
        run_over(pair_of_workers.address, dask_processes.double, [1], paths=[tmp_path, tmp_path / "nowhere"])


def test_workers_with_several_threads_are_refused(tmp_path):
    with dask_processes.cluster(tmp_path, 1, threads=2) as found:  # noqa: SIM117
        with pytest.raises(InputError, match=r"expected one thread \(.*\), found 2"):
            run_over(found.address, dask_processes.double, [1])


def test_a_scheduler_without_workers_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(over, "_WORKERS_S", 0.3)
    with dask_processes.cluster(tmp_path, 0) as found, pytest.raises(SvcError, match="expected a worker, found none"):
        run_over(found.address, dask_processes.double, [1])


def test_a_run_ends_when_all_workers_have_gone(tmp_path, monkeypatch):
    monkeypatch.setattr(over, "_ALONE_S", 1.0)
    with dask_processes.cluster(tmp_path, 1) as found:
        (worker,) = found.workers
        with pytest.raises(SvcError, match="expected a scheduler with workers, found none"):
            run_over(found.address, dask_processes.double_slowly, range(50), lambda *_: worker.kill())


@pytest.mark.parametrize(
    ("address", "message"), [("host:8786", "expected 'local' or an address"), ("tcp://127.0.0.1:9", "found none that")]
)
def test_wrong_addresses_are_told(monkeypatch, address, message):
    monkeypatch.setattr(over, "_CONNECT_S", 0.3)
    with pytest.raises(SvcError, match=message):
        run_over(address, dask_processes.double, [1])


def test_a_missing_package_is_told_with_its_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match="pip install distributed"):
        run_over(LOCAL, dask_processes.double, [1])
