"""The executor stays alive: a 100 Hz timer beside the working node, in the process and executor of both."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rclpy.clock import Clock, ClockType  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from yardstick import PATIENCE_S  # noqa: E402

from svc_ros.ros.collector import spin_until  # noqa: E402
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id  # noqa: E402
from svc_ros.ros.registration_node import RegistrationNode  # noqa: E402

pytestmark = pytest.mark.dds

PERIOD_S, MAX_LATE_MS = 0.01, 25.0
QUIET_MS = 5.0  # a machine that is later than that is busy with something else
# The same beat in a process that does nothing else: how late the machine itself is, with all that runs on it.
CONTROL = """
import sys, threading, time
late, done = [], threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), done.set()), daemon=True).start()
while not done.is_set():
    start = time.monotonic()
    time.sleep(0.01)
    late.append(1e3 * (time.monotonic() - start - 0.01))
print(sorted(late)[int(0.99 * len(late))])
"""
THREADS = Path("/proc/self/task")
TOPICS = ("points", "source_points", "target_points")
DRIVE, WALK = ("bags", "hdl64_kitti_a_10hz"), ("bags", "os0_64_walk", "ros2_mcap")
LOOPS = {"mode": "loop_closure", "loop_closure.min_gap_s": 1.0, "loop_closure.keyframe_distance_m": 0.5}


def threads_ms() -> dict[str, tuple[float, float]]:
    """Of each thread of this process, how long it has run on a processor so far, and waited for one."""
    times = {}
    for thread in THREADS.iterdir():
        with contextlib.suppress(OSError):  # it has ended meanwhile
            ran, waited = (thread / "schedstat").read_text().split()[:2]
            times[thread.name] = 1e-6 * int(ran), 1e-6 * int(waited)
    return times


class Heart:
    """A 100 Hz timer that writes down how late it is, and how much of that some thread of this process is to blame for.

    Whoever keeps the timer waiting computes meanwhile, and no thread has to wait for a processor.
    """

    def __init__(self, node) -> None:
        self.late_ms, self.kept_waiting_ms = [], []
        self._node, self._last_s, self._threads = node, time.monotonic(), threads_ms()
        self._timer = node.create_timer(PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        self._node.destroy_timer(self._timer)

    def _tick(self) -> None:
        now, threads = time.monotonic(), threads_ms()
        late = max(1e3 * (now - self._last_s - PERIOD_S), 0.0)
        self.late_ms.append(late)
        before = {name: self._threads.get(name, (0.0, 0.0)) for name in threads}
        computed = max(ran - before[name][0] for name, (ran, _) in threads.items())
        waited = sum(waited - before[name][1] for name, (_, waited) in threads.items())
        self.kept_waiting_ms.append(min(max(late - waited, 0.0), computed))
        self._last_s, self._threads = now, threads


@pytest.mark.skipif(not THREADS.is_dir(), reason="needs /proc of Linux")
@pytest.mark.parametrize(
    ("bag", "arguments", "values"),
    [
        (DRIVE, ["--scans", "--rate", "5"], {"mode": "scan_matching"}),
        (WALK, ["--scans", "--rate", "12"], {"mode": "scan_matching", "preset": "lidar_indoor"}),
        (DRIVE, ["--rate", "1", "--limit", "8"], {"mode": "pair"}),
        (DRIVE, ["--scans", "--rate", "5"], LOOPS),
        (WALK, ["--scans", "--rate", "12"], {**LOOPS, "preset": "lidar_indoor"}),
    ],
    ids=["scan_matching-drive", "scan_matching-walk", "pair-drive", "loop_closure-drive", "loop_closure-walk"],
)
@pytest.mark.slow  # it measures time: what else runs on the machine counts
def test_a_timer_at_100_hz_is_in_time_while_real_scans_are_computed(
    shared_data, tmp_path, monkeypatch, bag, arguments, values
):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id, context = own_domain_id(40), Context()
    rclpy.init(context=context, domain_id=domain_id)
    values = {**values, **{f"qos_overrides./{t}.subscription.reliability": "reliable" for t in TOPICS}}
    given = [Parameter(name, value=value) for name, value in values.items()]
    node = RegistrationNode(context=context, parameter_overrides=given)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    player_args = [str(shared_data.joinpath(*bag)), *arguments, "--wait-for-subscribers", "20"]
    try:
        session = node._session
        assert spin_until(executor, session.worker.ready.is_set, PATIENCE_S)
        with ChildProcess(
            "svc_ros.ros.bag_player", player_args, local_environment(domain_id), tmp_path / "log"
        ) as player:
            assert spin_until(executor, lambda: session.statistics.numbers()["jobs"]["received"] > 0, PATIENCE_S)
            control = subprocess.Popen(
                [sys.executable, "-c", CONTROL], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            heart = Heart(node)
            assert spin_until(executor, lambda: player.exit_code is not None, PATIENCE_S)
            heart.stop()
            machine_ms = float(control.communicate()[0])
        counts = session.statistics.numbers()["decisions"]
    finally:
        node.stop(PATIENCE_S)
        node.destroy_node()
        context.try_shutdown()
    assert counts["accepted"] >= 1, counts  # there was work
    assert len(heart.late_ms) > 100
    late, kept_waiting = np.percentile(heart.late_ms, 99), np.percentile(heart.kept_waiting_ms, 99)
    print(f"99th percentile: {late:.1f} ms late, {kept_waiting:.1f} ms kept waiting; the machine {machine_ms:.1f} ms")
    print(f"longest: {max(heart.late_ms):.1f} ms late, {max(heart.kept_waiting_ms):.1f} ms kept waiting")
    assert kept_waiting < MAX_LATE_MS
    assert late < MAX_LATE_MS + machine_ms or machine_ms > QUIET_MS
