"""The engine of loop closure with its judges, without a node: what is followed, judged, given up and written."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest
from mini_data import scan_room, sensor_pose
from plain_clouds import plain_cloud
from yardstick import PATIENCE_S

from svc_ros.core.config import preset, with_values
from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason
from svc_ros.core.se3 import make_pose
from svc_ros.io.clouds.point_cloud2 import scan_from_cloud
from svc_ros.io.g2o import read_g2o
from svc_ros.pipeline import loop_closure
from svc_ros.pipeline.loop_closure import LoopCloser, judge_candidate
from svc_ros.ros.streams.judges import Judges
from svc_ros.ros.streams.loop_engine import LoopEngine
from svc_ros.ros.streams.worker import PairJob, ScanJob

S = 1_000_000_000
CONFIG = with_values(preset("lidar_indoor"), {"loop_closure.min_gap_s": 5.0, "loop_closure.keyframe_distance_m": 0.5})
ALONG = (-3.0, -2.0, -1.0, 0.0, 1.0)
WAY = [sensor_pose(x, 0.0, 0.0) for x in ALONG] + [sensor_pose(x, 0.0, 180.0) for x in reversed(ALONG)]
SCANS = [scan_room(T, seed=k) for k, T in enumerate(WAY)]


class Sources:
    """Odometry that is exact; no guesses; clouds in the sensor's frame."""

    odometry_frame = "odom"

    def origin(self, frame, stamp_ns):
        return np.zeros(3)

    def guess(self, stamp_ns):
        return None

    def odometry(self, scan):
        return WAY[scan.stamp_ns // S]


class Bench:
    """Does what the node's worker does; `told` has (source, target, reason) of each decision, a list a job."""

    def __init__(self, num_threads=2, graph_file=None) -> None:
        self.told = []
        self.judges = Judges(self.told.append, num_threads)
        self.engine = LoopEngine(Sources(), False, self.judges.wait, graph_file)

    def walk(self, numbers=range(10), capacity=100, every=False, config=CONFIG) -> None:
        for k in numbers:
            self.process(ScanJob(plain_cloud(SCANS[k], k * S)), capacity, every, config)

    def process(self, job, capacity=100, every=False, config=CONFIG) -> None:
        self.judges.put(self.engine.process(job, config), capacity, every)

    def decisions(self):
        """Source and target [s] and reason of what is told so far."""
        return [
            (d.source.stamp_ns // S, d.target.stamp_ns // S, d.result.reason.value) for job in self.told for d in job
        ]


@pytest.fixture
def held(monkeypatch):
    """Judging that has begun, and lasts until it may end."""
    begun, may_end = threading.Semaphore(0), threading.Event()

    def judge(*args):
        begun.release()
        assert may_end.wait(PATIENCE_S)
        return judge_candidate(*args)

    monkeypatch.setattr(loop_closure, "judge_candidate", judge)
    yield begun, may_end
    may_end.set()


@pytest.fixture(scope="module")
def replayed():
    """What the same scans lead to in a replay: one thread does one after the other."""
    closer = LoopCloser(CONFIG)
    messages = [plain_cloud(points, k * S).message for k, points in enumerate(SCANS)]
    return [closer.add(scan_from_cloud(message).scan, WAY[k]) for k, message in enumerate(messages)]


@pytest.mark.parametrize("num_threads", [1, 3])
def test_the_node_decides_what_a_replay_decides_in_the_same_order(replayed, num_threads) -> None:
    bench = Bench(num_threads)
    bench.walk(capacity=1, every=True)
    bench.judges.wait()
    assert len(bench.told) == len(SCANS)
    assert [len(job) for job in bench.told] == [len(decisions) for decisions in replayed]
    live = [d for job in bench.told for d in job]
    for decision, wanted in zip(live, (d for decisions in replayed for d in decisions), strict=True):
        assert (decision.source.stamp_ns, decision.target.stamp_ns) == (wanted.source_stamp_ns, wanted.target_stamp_ns)
        assert decision.result.probability == wanted.result.probability
        assert decision.result.T_target_source.tobytes() == wanted.result.T_target_source.tobytes()
        assert decision.origin == wanted.origin
    assert bench.engine.numbers() == {"keyframes": 10, "loops": 5}


def test_scans_are_followed_while_a_candidate_is_judged(held) -> None:
    begun, may_end = held
    bench = Bench(num_threads=1)
    bench.walk()
    assert begun.acquire(timeout=PATIENCE_S)
    assert bench.engine.numbers() == {"keyframes": 10, "loops": 0}
    assert bench.decisions() == []
    may_end.set()
    bench.judges.wait()
    assert bench.engine.numbers() == {"keyframes": 10, "loops": 5}


def test_a_reset_that_forgets_loops_is_a_change_of_the_graph() -> None:
    bench = Bench()
    bench.walk()
    bench.judges.wait()
    before = bench.engine.graph()
    bench.engine.reset()
    assert bench.engine.graph() is None
    bench.walk(range(2))
    bench.judges.wait()
    after = bench.engine.graph()
    assert len(after[1]) == 2
    assert after[0] > before[0]


def test_keyframes_that_cannot_be_judged_in_time_are_superseded_and_still_targets(held) -> None:
    begun, may_end = held
    bench = Bench(num_threads=1)
    bench.walk(range(6))
    assert begun.acquire(timeout=PATIENCE_S)
    bench.walk(range(6, 10), capacity=2)
    may_end.set()
    bench.judges.wait()
    assert sorted(bench.decisions()) == [
        (5, 0, "ok"), (6, 6, "superseded"), (7, 7, "superseded"), (8, 1, "ok"), (9, 0, "ok")
    ]  # fmt: skip
    assert bench.engine.numbers() == {"keyframes": 10, "loops": 3}
    assert sorted(len(job) for job in bench.told) == [0] * 5 + [1] * 5


def test_a_reset_every_for_what_is_being_judged_and_writes_it(held, tmp_path) -> None:
    begun, may_end = held
    bench = Bench(num_threads=2, graph_file=tmp_path / "loops.g2o")
    bench.walk()
    for _ in range(2):
        assert begun.acquire(timeout=PATIENCE_S)
    bench.judges.give_up(Reason.STALE, "the node was reset")
    reset = threading.Thread(target=bench.engine.reset)
    reset.start()
    reset.join(0.2)
    assert reset.is_alive()
    may_end.set()
    reset.join(PATIENCE_S)
    assert [reason for _, _, reason in sorted(bench.decisions())] == ["ok", "ok", "stale", "stale", "stale"]
    assert bench.engine.numbers() == {"keyframes": 0, "loops": 0}
    assert len(read_g2o(tmp_path / "loops.g2o").edges) == len(WAY) - 1 + 2


@pytest.mark.parametrize("change", ["time", "configuration"])
def test_what_begins_anew_every_for_the_loops_of_before(held, tmp_path, change) -> None:
    _, may_end = held
    bench = Bench(num_threads=2, graph_file=tmp_path / "loops.g2o")
    bench.walk()
    threading.Timer(0.2, may_end.set).start()
    if change == "time":
        bench.walk([0])
    else:
        later = ScanJob(plain_cloud(SCANS[9], 9 * S + 1))
        bench.process(later, config=with_values(CONFIG, {"loop_closure.max_near": 2}))
    assert len(read_g2o(tmp_path / "loops.g2o").edges) == len(WAY) - 1 + 5
    assert bench.engine.numbers() == {"keyframes": 1, "loops": 0}


def test_an_exception_while_judging_is_a_decision_and_the_others_go_on(monkeypatch) -> None:
    def judge(source, *args):
        if source.scan.stamp_ns == 6 * S:
            raise RuntimeError("boom")
        return judge_candidate(source, *args)

    monkeypatch.setattr(loop_closure, "judge_candidate", judge)
    bench = Bench(num_threads=2)
    bench.walk()
    bench.judges.wait()
    assert [(source, reason) for source, _, reason in sorted(bench.decisions())] == [
        (5, "ok"), (6, "internal_error"), (7, "ok"), (8, "ok"), (9, "ok")
    ]  # fmt: skip


def test_candidates_from_outside_keep_no_scan_waiting(held) -> None:
    begun, may_end = held
    bench = Bench(num_threads=1)
    bench.process(PairJob(plain_cloud(SCANS[9], 50 * S), plain_cloud(SCANS[0], 50 * S)))
    assert begun.acquire(timeout=PATIENCE_S)
    bench.walk(range(1, 4))
    assert bench.engine.numbers()["keyframes"] == 3
    may_end.set()
    bench.judges.wait()
    assert bench.decisions() == [(50, 50, "ok")]
    assert bench.told[-1][0].origin == "given"


def test_the_last_candidate_is_judged_again_while_others_are_judged() -> None:
    bench = Bench(num_threads=2)
    with pytest.raises(InputError, match="expected a scan whose pose was judged"):
        bench.engine.judge_again(CONFIG)
    bench.walk()
    while bench.judges.num_waiting:
        if bench.engine.numbers()["loops"]:
            assert bench.engine.judge_again(CONFIG)["verdict"] == "accepted"
    bench.judges.wait()
    again = bench.engine.judge_again(CONFIG)
    assert (again["verdict"], again["source_stamp_ns"]) == ("accepted", 9 * S)


def test_at_every_moment_each_scan_is_pending_without_candidate_or_decided(held) -> None:
    pytest.importorskip("diagnostic_msgs", reason="needs rclpy (pip install svc_ros[ros])")
    from svc_ros.ros.diagnostics import Statistics

    begun, may_end = held
    statistics = Statistics({"points": True})
    bench = Bench(num_threads=1)
    bench.judges = Judges(statistics.finish, 1)

    def counts() -> tuple[int, int, int]:
        numbers = statistics.numbers()
        jobs, decided = numbers["jobs"], sum(numbers["decisions"].values())
        assert jobs["received"] == jobs["pending"] + jobs["without_candidate"] + decided
        return jobs["pending"], jobs["without_candidate"], decided

    for k in range(6):
        statistics.receive()
        bench.walk([k])
    assert begun.acquire(timeout=PATIENCE_S)
    assert counts() == (1, 5, 0)
    for k in range(6, 10):
        statistics.receive()
        bench.walk([k], capacity=2)
    assert counts() == (3, 5, 2)
    bench.judges.give_up(Reason.INACTIVE, "the node was disabled")
    may_end.set()
    bench.judges.wait()
    assert counts() == (0, 5, 5)
    assert statistics.numbers()["reasons"] == {"superseded": 2, "inactive": 2, "ok": 1}


def test_a_later_word_is_told_after_what_caused_it_as_in_a_replay(monkeypatch, tmp_path) -> None:
    """The first loop is accepted and 3 m off: odometry may have drifted by so much; the next loops say otherwise."""

    def judge(source, target, guess, config):
        result = judge_candidate(source, target, guess, config)
        if source.scan.stamp_ns != 5 * S:
            return result
        T = make_pose(np.eye(3), (0.0, 3.0, 0.0)) @ result.T_target_source
        return dataclasses.replace(result, T_target_source=T, best_candidate=T, probability=0.9)

    monkeypatch.setattr(loop_closure, "judge_candidate", judge)
    config = with_values(CONFIG, {"agreement.drift_ratio": 0.25, "agreement.independent_m": 0.5})
    closer = LoopCloser(config)
    messages = [plain_cloud(points, k * S).message for k, points in enumerate(SCANS)]
    replayed = [closer.add(scan_from_cloud(message).scan, WAY[k]) for k, message in enumerate(messages)]
    bench = Bench(3, tmp_path / "loops.g2o")
    bench.walk(capacity=1, every=True, config=config)
    bench.judges.wait()

    def words(told):
        return [[(d.result.verdict, d.result.reason, d.origin, d.result.detail) for d in job] for job in told]

    assert words(bench.told) == words(replayed)
    (withdrawn,) = (d for job in bench.told for d in job if d.origin == "agreement" and d.source.stamp_ns == 5 * S)
    assert withdrawn.result.reason is Reason.UNCONFIRMED
    assert withdrawn.vertices == (5, 0)
    assert bench.engine.numbers() == {"keyframes": 10, "loops": 4}
    bench.engine.write_graph()
    assert 5 not in {edge.source for edge in read_g2o(tmp_path / "loops.g2o").edges[9:]}
