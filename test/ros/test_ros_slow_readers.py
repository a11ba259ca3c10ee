"""Readers of the node's decisions that are slow, or stopped altogether, each in a process of its own."""

from __future__ import annotations

import contextlib
import itertools
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from ros_bench import Host, StreamBench, cloud
from sensor_msgs.msg import PointCloud2
from yardstick import PATIENCE_S, Stopwatch, assert_ends_within

from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import local_environment, own_domain_id

pytestmark = pytest.mark.dds

PERIOD_S = 0.01
# Reads every topic that the node may write, and writes down the stamp of each decision.
READER = """
import sys
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool

rclpy.init()
node, out = rclpy.create_node("reader"), open(sys.argv[1], "w")
def on_decision(message):
    print(next(kv.value for kv in message.status[0].values if kv.key == "source_stamp"), file=out, flush=True)
latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
name = "/svc_registration/"
node.create_subscription(DiagnosticArray, name + "decision", on_decision, latched)
for kind, topic in ((Bool, "rejected"), (Odometry, "odometry"), (Path, "path"), (PointCloud2, "aligned")):
    node.create_subscription(kind, name + topic, lambda message: None, 10)
rclpy.spin(node)
"""


@pytest.fixture
def host(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with contextlib.closing(Host(own_domain_id(80))) as host:
        yield host


class Reader:
    """A reader in a process that can be stopped and go on; leaving the context ends it."""

    def __init__(self, file: Path, domain_id: int) -> None:
        self._file = file
        command = [sys.executable, "-c", READER, str(file)]
        self._process = subprocess.Popen(command, env=local_environment(domain_id))

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.go_on()
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self._process.send_signal(signal.SIGCONT)

    @property
    def stamps(self) -> list[str]:
        return self._file.read_text("utf-8").split() if self._file.exists() else []


class Stream:
    """A scan matching node in this process, a publisher of clouds that are refused at once, and a healthy reader."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.node = host.start(mode="scan_matching", **{"qos_overrides./points.subscription.depth": 1000})
        self.points = host.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=1000))
        self.collector = DecisionCollector(host.node, host.executor)
        self._stamps = itertools.count(1)
        assert spin_until(host.executor, self.points.get_subscription_count, PATIENCE_S)
        assert spin_until(host.executor, lambda: host.status()["worker"]["ready"], PATIENCE_S)

    @property
    def stamps(self) -> list[str]:
        return [decision["source_stamp"] for decision in self.collector.answers.decisions]

    def wait_for_readers(self, count: int) -> None:
        (publisher,) = [p for p in self.node.publishers if p.topic_name.endswith("/decision")]
        assert spin_until(self.host.executor, lambda: publisher.get_subscription_count() == count, PATIENCE_S)

    def play(self, seconds: float, rate_hz: float) -> int:
        """Publish at that rate; returns how many."""
        start, num_played = time.monotonic(), 0
        while time.monotonic() - start < seconds:
            self.points.publish(cloud(np.ones((1, 3)), next(self._stamps)))
            num_played += 1
            due = start + num_played / rate_hz
            spin_until(self.host.executor, lambda due=due: time.monotonic() >= due, 60.0)
        return num_played


@contextlib.contextmanager
def lateness_ms(host):
    """Lateness of the ticks of a 100 Hz timer in the node's executor, less what other programs had meanwhile."""
    ticks, late = [], []

    def tick() -> None:
        watch.look()
        ticks.append(time.monotonic() - watch.others_so_far_s)

    with Stopwatch() as watch:
        timer = host.node.create_timer(PERIOD_S, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        yield late
        host.node.destroy_timer(timer)
    late += (1e3 * np.maximum(np.diff(ticks) - PERIOD_S, 0.0)).tolist()


def test_a_stopped_reader_keeps_neither_timer_nor_worker_nor_other_readers_waiting(host, tmp_path):
    stream, warnings = Stream(host), []

    def on_diagnostics(message):
        warnings.extend(s.message for s in message.status if "does not acknowledge" in s.message)

    host.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    with Reader(tmp_path / "stamps", host.domain_id) as reader:
        stream.wait_for_readers(2)
        before = stream.play(0.5, 20.0)
        assert spin_until(host.executor, lambda: len(reader.stamps) == before, PATIENCE_S)
        reader.stop()
        with lateness_ms(host) as late:
            num_played = before + stream.play(4.0, 25.0)
            jobs = host.status()["jobs"]
        assert jobs["received"] - jobs["pending"] >= num_played - 2  # the worker is not behind
        with Stopwatch() as watch:
            assert spin_until(host.executor, lambda: len(stream.stamps) == num_played, PATIENCE_S)
        assert watch.own_s < 3.0, watch
        output = host.status()["output"]
        assert output["reader_stopped"]
        assert 0.5 * (num_played - before) < output["unacknowledged"] < num_played
        assert warnings
        # It goes on: the decisions of meanwhile are lost to it, all but the last, and the next ones reach it.
        reader.go_on()
        assert spin_until(host.executor, lambda: not host.status()["output"]["reader_stopped"], PATIENCE_S)
        after = stream.play(0.5, 20.0)
        assert spin_until(host.executor, lambda: reader.stamps[-1:] == stream.stamps[-1:], PATIENCE_S)
        assert reader.stamps[-after - 1 :] == stream.stamps[-after - 1 :]
        assert host.status()["output"]["unacknowledged"] == output["unacknowledged"]
    assert stream.stamps == [f"{stamp}.000000000" for stamp in range(1, num_played + after + 1)]
    assert len(late) > 20
    assert np.percentile(late, 99) < 100.0  # it was 200 ms for each decision
    assert len([ms for ms in late if ms > 150.0]) <= 1


def test_a_reader_that_is_slow_gets_every_decision_of_a_burst(host, tmp_path):
    stream = Stream(host)
    with Reader(tmp_path / "stamps", host.domain_id) as reader:
        stream.wait_for_readers(2)
        num_played = stream.play(0.3, 300.0)
        end = time.monotonic() + PATIENCE_S
        while len(reader.stamps) < num_played and time.monotonic() < end:  # it runs a tenth of the time
            reader.stop()
            spin_until(host.executor, lambda: False, 0.36)
            reader.go_on()
            spin_until(host.executor, lambda: False, 0.04)
        assert spin_until(host.executor, lambda: len(stream.stamps) == num_played, PATIENCE_S)
        output = host.status()["output"]
        assert (output["unacknowledged"], output["waiting"], output["reader_stopped"]) == (0, 0, False)
        assert reader.stamps == stream.stamps == [f"{stamp}.000000000" for stamp in range(1, num_played + 1)]


@pytest.mark.slow
def test_ctrl_c_ends_the_node_in_time_though_decisions_wait_for_a_stopped_reader(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    parameters = {"mode": "scan_matching", "preset": "lidar_indoor"}
    domain_id = own_domain_id(81)
    with StreamBench(tmp_path, domain_id, parameters) as bench, Reader(tmp_path / "stamps", domain_id) as reader:
        bench.play([cloud(np.ones((1, 3)), 1.0)], 10.0)
        assert spin_until(bench.executor, lambda: reader.stamps, PATIENCE_S)
        reader.stop()
        bench.play([cloud(np.ones((1, 3)), 2.0 + k) for k in range(60)], 100.0)
        assert bench.status()["output"]["waiting"] > 0
        assert_ends_within(2.0, bench.process)
        assert "Traceback" not in bench.process.output()
