"""Jobs, queue, thread and registrar of the node, without a node."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from mini_data import POSES, pose_between, scan_room
from plain_clouds import plain_cloud as cloud
from plain_clouds import small_pair
from yardstick import PATIENCE_S

from svc_ros.core.config import preset
from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.kernels.place import correlate
from svc_ros.core.result import Reason, Verdict
from svc_ros.core.se3 import pose_error
from svc_ros.ros.streams import registrar as registrar_module
from svc_ros.ros.streams.registrar import PairRegistrar, warm_up
from svc_ros.ros.streams.worker import DropJob, JobQueue, PairJob, Worker

CONFIG = preset("lidar_indoor")
SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]


def stamps_and_kinds(queue, count):
    return [(type(job).__name__, job.source.stamp_ns) for job in (queue.get() for _ in range(count))]


def at_origin(_frame, _stamp_ns):
    return np.zeros(3)


def test_newest_pair_supersedes_the_oldest_in_its_place():
    queue = JobQueue()
    for stamp in (1, 2, 3):
        queue.put(small_pair(stamp), capacity=2)
    assert queue.num_waiting == 2
    assert stamps_and_kinds(queue, 3) == [("DropJob", 1), ("PairJob", 2), ("PairJob", 3)]


def test_queue_without_bound_keeps_every_pair():
    queue = JobQueue()
    for stamp in range(50):
        queue.put(small_pair(stamp), capacity=None)
    assert queue.num_waiting == 50


def test_drops_never_take_the_place_of_a_pair():
    queue = JobQueue()
    queue.put(small_pair(1), capacity=1)
    for stamp in (2, 3, 4):
        queue.put(small_pair(stamp).drop(Reason.TIME_SKEW, ""), capacity=1)
    assert queue.num_waiting == 1


def test_given_up_pairs_keep_their_place_and_get_the_reason():
    queue = JobQueue()
    queue.put(small_pair(1), capacity=None)
    queue.give_up(Reason.INACTIVE, "off")
    job = queue.get()
    assert isinstance(job, DropJob)
    assert (job.source.stamp_ns, job.reason, job.detail) == (1, Reason.INACTIVE, "off")


def test_worker_processes_on_after_an_exception(caplog):
    done, finished = [], threading.Event()

    def process(job):
        if job.source.stamp_ns == 1:
            raise RuntimeError("boom")
        done.append(job.source.stamp_ns)
        finished.set()

    worker = Worker(process, prepare=lambda: None)
    worker.jobs.put(small_pair(1), None)
    worker.jobs.put(small_pair(2), None)
    worker.start()
    assert finished.wait(PATIENCE_S)
    assert worker.stop(PATIENCE_S)
    assert done == [2]
    assert "boom" in caplog.text


def test_worker_is_ready_after_preparing_even_if_that_fails(caplog):
    def prepare():
        raise RuntimeError("no compiler")

    worker = Worker(lambda job: None, prepare)
    assert not worker.ready.is_set()
    worker.start()
    assert worker.ready.wait(PATIENCE_S)
    assert worker.stop(PATIENCE_S)
    assert "no compiler" in caplog.text


def test_stop_says_when_a_job_takes_too_long():
    release = threading.Event()
    worker = Worker(lambda job: release.wait(PATIENCE_S), prepare=lambda: None)
    worker.jobs.put(small_pair(1), None)
    worker.start()
    worker.ready.wait(PATIENCE_S)
    assert worker.stop(0.1) is False
    release.set()
    assert worker.stop(PATIENCE_S) is True


def test_stop_answers_what_waits_and_leaves_calls_out():
    release, begun, done, called = threading.Event(), threading.Event(), [], []

    def process(job):
        done.append(job)
        begun.set()
        release.wait(PATIENCE_S)

    worker = Worker(process, prepare=lambda: None)
    worker.start()
    for stamp in (1, 2, 3):
        worker.jobs.put(small_pair(stamp), None)
    worker.jobs.call_next(lambda: called.append(True))
    assert begun.wait(PATIENCE_S)
    threading.Timer(0.2, release.set).start()
    called.clear()
    worker.jobs.call_next(lambda: called.append(True))
    assert worker.stop(PATIENCE_S)
    assert [getattr(job, "reason", None) for job in done] == [None, Reason.INACTIVE, Reason.INACTIVE]
    assert called == []


def test_pair_of_one_room_is_accepted():
    decision = PairRegistrar(at_origin).decide(PairJob(cloud(SCANS[1], 5), cloud(SCANS[0], 5)), CONFIG)
    assert decision.result.verdict is Verdict.ACCEPTED
    rotation_deg, translation_m = pose_error(decision.result.T_target_source, pose_between(1, 0))
    assert rotation_deg < 1.0
    assert translation_m < 0.1
    assert decision.timings_ms.keys() == {"queue_ms", "features_ms", "latency_ms"}


def test_same_cloud_under_another_stamp_is_described_once():
    registrar = PairRegistrar(at_origin)
    first = registrar.decide(PairJob(cloud(SCANS[1], 1), cloud(SCANS[0], 1)), CONFIG)
    second = registrar.decide(PairJob(cloud(SCANS[2], 2), cloud(SCANS[1], 2)), CONFIG)
    assert registrar.num_reused == 1
    assert second.look.target is first.look.source
    registrar.reset()
    registrar.decide(PairJob(cloud(SCANS[2], 2), cloud(SCANS[1], 2)), CONFIG)
    assert registrar.num_reused == 1


@pytest.mark.parametrize("change", ["frame", "config", "origin", "data"])
def test_cache_is_not_used_when_anything_else_differs(change):
    origins = [np.zeros(3)]
    registrar = PairRegistrar(lambda _frame, _stamp: origins[-1])
    registrar._work("source", cloud(SCANS[0]), CONFIG)
    config, points, frame = CONFIG, SCANS[0], "lidar"
    if change == "frame":
        frame = "other"
    elif change == "config":
        config = preset("lidar_outdoor")
    elif change == "origin":
        origins.append(np.array([0.0, 0.0, 0.1]))
    else:
        points = np.vstack([SCANS[0][:-1], [[1.0, 1.0, 1.0]]])
    registrar._work("source", cloud(points, frame=frame), config)
    assert registrar.num_reused == 0


def test_failing_lookup_of_the_sensor_rejects_the_pair_and_names_frames_and_side():
    def unavailable(frame, stamp_ns):
        raise TransformUnavailableError(f"expected a transform from 'lidar' to {frame!r} at {stamp_ns} ns")

    decision = PairRegistrar(unavailable).decide(small_pair(7), CONFIG)
    assert (decision.result.verdict, decision.result.reason) == (Verdict.REJECTED, Reason.TF_UNAVAILABLE)
    assert decision.result.detail == "source: expected a transform from 'lidar' to 'lidar' at 7 ns"


def test_defect_while_computing_is_a_decision_and_the_next_pair_is_registered(monkeypatch):
    registrar = PairRegistrar(at_origin)

    def broken(*_args):
        raise MemoryError("no room")

    job = PairJob(cloud(SCANS[1], 1), cloud(SCANS[0], 1))
    with monkeypatch.context() as patch:
        patch.setattr(registrar_module, "extract_features", broken)
        decision = registrar.decide(job, CONFIG)
    assert (decision.result.verdict, decision.result.reason) == (Verdict.REJECTED, Reason.INTERNAL_ERROR)
    assert decision.result.detail == "MemoryError: no room"
    assert registrar.decide(job, CONFIG).result.accepted


def test_good_guess_is_verified_without_a_search(monkeypatch):
    def no_search(*_args):
        raise AssertionError("searched")

    monkeypatch.setattr(registrar_module, "register_pair", no_search)
    registrar = PairRegistrar(at_origin, lambda _stamp: pose_between(1, 0))
    decision = registrar.decide(PairJob(cloud(SCANS[1], 1), cloud(SCANS[0], 1)), CONFIG)
    assert decision.result.accepted
    assert "hypotheses" not in decision.result.counts


def test_wrong_guess_falls_back_to_the_search():
    wrong = pose_between(1, 0).copy()
    wrong[:3, 3] += (3.0, -2.5, 0.0)
    registrar = PairRegistrar(at_origin, lambda _stamp: wrong)
    decision = registrar.decide(PairJob(cloud(SCANS[1], 1), cloud(SCANS[0], 1)), CONFIG)
    assert decision.result.accepted
    assert pose_error(decision.result.T_target_source, pose_between(1, 0))[1] < 0.1


@pytest.mark.parametrize("name", ["lidar_outdoor", "lidar_indoor", "rgbd_indoor"])
def test_warm_up_runs_the_whole_registration(name, monkeypatch):
    results = []
    register = registrar_module.register_pair
    monkeypatch.setattr(registrar_module, "register_pair", lambda *a: results.append(register(*a)))
    warm_up.cache_clear()
    warm_up(preset(name))
    same, other = results
    assert same.evidence is not None
    assert same.verdict is Verdict.ACCEPTED
    assert other.verdict is not Verdict.ACCEPTED
    assert other.time_ms["levelled"] > 0  # what only hard pairs need was run as well
    assert correlate.signatures  # nor is anything compiled when a place is searched for
    warm_up(preset(name))
    assert len(results) == 2  # a process that is warm has nothing to do
