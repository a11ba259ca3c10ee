"""The executor stays alive: a 100 Hz timer beside the working node, in the process and executor of both."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from rclpy.clock import Clock, ClockType  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from svc_ros.ros.collector import spin_until  # noqa: E402
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id  # noqa: E402
from svc_ros.ros.registration_node import RegistrationNode  # noqa: E402

pytestmark = pytest.mark.dds

PERIOD_S, MAX_LATE_MS = 0.01, 25.0
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
TOPICS = ("points", "source_points", "target_points")
BAG = ("bags", "hdl64_kitti_a_10hz")


@pytest.mark.parametrize(
    ("mode", "arguments"), [("scan_matching", ["--scans", "--rate", "5"]), ("pair", ["--rate", "1", "--limit", "8"])]
)
@pytest.mark.slow  # it measures time: what else runs on the machine counts
def test_a_timer_at_100_hz_is_in_time_while_real_scans_are_computed(
    shared_data, tmp_path, monkeypatch, mode, arguments
):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    domain_id, context = own_domain_id(40), Context()
    rclpy.init(context=context, domain_id=domain_id)
    values = {"mode": mode, **{f"qos_overrides./{t}.subscription.reliability": "reliable" for t in TOPICS}}
    given = [Parameter(name, value=value) for name, value in values.items()]
    node = RegistrationNode(context=context, parameter_overrides=given)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    player_args = [str(shared_data.joinpath(*BAG)), *arguments, "--wait-for-subscribers", "20"]
    try:
        session = node._session
        assert spin_until(executor, session.worker.ready.is_set, 60.0)
        ticks: list[float] = []
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        with ChildProcess(
            "svc_ros.ros.bag_player", player_args, local_environment(domain_id), tmp_path / "log"
        ) as player:
            assert spin_until(executor, lambda: session.statistics.numbers()["jobs"]["received"] > 0, 30.0)
            control = subprocess.Popen(
                [sys.executable, "-c", CONTROL], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            timer = node.create_timer(PERIOD_S, lambda: ticks.append(time.monotonic()), clock=steady)
            assert spin_until(executor, lambda: player.exit_code is not None, 30.0)
            node.destroy_timer(timer)
            machine_ms = float(control.communicate()[0])
        counts = session.statistics.numbers()["decisions"]
    finally:
        node.stop(30.0)
        node.destroy_node()
        context.try_shutdown()
    late_ms = 1e3 * np.maximum(np.diff(ticks) - PERIOD_S, 0.0)
    assert counts["accepted"] >= 3, counts  # there was work
    assert len(late_ms) > 100
    assert np.percentile(late_ms, 99) < MAX_LATE_MS + machine_ms
