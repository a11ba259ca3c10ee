"""The executor stays alive: a 100 Hz timer beside the working node, in the process and executor of both."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from other_programs import OtherPrograms  # noqa: E402
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
THREADS = Path("/proc/self/task")
TOPICS = ("points", "source_points", "target_points")
DRIVE, WALK = ("bags", "hdl64_kitti_a_10hz"), ("bags", "os0_64_walk", "ros2_mcap")
LOOPS = {"mode": "loop_closure", "loop_closure.min_gap_s": 1.0, "loop_closure.keyframe_distance_m": 0.5}


class Heart:
    """A 100 Hz timer that writes down when it is called."""

    def __init__(self, node) -> None:
        self._node, self.times_s = node, []
        self._timer = node.create_timer(PERIOD_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def stop(self) -> None:
        self._node.destroy_timer(self._timer)

    def late_ms(self, others: OtherPrograms) -> tuple[np.ndarray, np.ndarray]:
        """How late each call was, and how late less what threads waited for a processor.

        What is left of that is the node's: somebody computes, or waits, with Python's lock in its hand.
        """
        times_s = np.array(self.times_s)
        late_s = np.maximum(np.diff(times_s) - PERIOD_S, 0.0)
        return 1e3 * late_s, 1e3 * np.maximum(late_s - np.diff(others.had_s(times_s)), 0.0)

    def _tick(self) -> None:
        self.times_s.append(time.monotonic())


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
            with OtherPrograms() as others:
                heart = Heart(node)
                assert spin_until(executor, lambda: player.exit_code is not None, PATIENCE_S)
                heart.stop()
        counts = session.statistics.numbers()["decisions"]
    finally:
        node.stop(PATIENCE_S)
        node.destroy_node()
        context.try_shutdown()
    assert counts["accepted"] >= 1, counts  # there was work
    late_ms, own_ms = heart.late_ms(others)
    assert len(late_ms) > 100
    late, own = np.percentile(late_ms, 99), np.percentile(own_ms, 99)
    print(f"99th percentile: {late:.1f} ms late, {own:.1f} ms of them the node's own")
    print(f"longest: {max(late_ms):.1f} ms late, {max(own_ms):.1f} ms own")
    assert own < MAX_LATE_MS
