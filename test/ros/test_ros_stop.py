"""Ctrl-C and SIGTERM: exit code 0 without a word, at every moment of the start and in the middle of work."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

import tripwire
from mini_data import POSES, scan_room
from places import PROJECT_ROOT
from ros_bench import Bench, cloud
from yardstick import PATIENCE_S, time_to_end

from svc_ros.ros.collector import spin_until
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id

pytestmark = pytest.mark.dds

SCANS = [scan_room(T, seed=k) for k, T in enumerate(POSES)]
MUCH_S = 0.1  # of the time to end in
NOISE = ("Traceback", "rosout", "invalid", "Error", "ERROR", "failed")


def assert_quiet(text: str) -> None:
    assert not [line for line in text.splitlines() if any(word in line for word in NOISE)], text


@pytest.mark.parametrize("number", [2, 3, 4, 20, 71, 150, 320, 546, 900])
def test_a_signal_while_it_imports_is_exit_code_0(tmp_path, number):
    signum = signal.SIGINT if number % 2 else signal.SIGTERM
    environment = {**local_environment(own_domain_id(61)), "PYTHONPATH": str(PROJECT_ROOT)}
    command = [sys.executable, tripwire.__file__, str(number), str(int(signum))]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


@pytest.mark.parametrize("signum", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_while_it_warms_up_is_exit_code_0_and_quiet(tmp_path, signum):
    with ChildProcess("svc_ros.ros.node", [], local_environment(own_domain_id(62)), tmp_path / "log") as node:
        while "warming up" not in node.output():
            assert node.wait(0.01) is None, node.output()
        node.interrupt(signum)
        assert node.wait(PATIENCE_S) == 0
        assert_quiet(node.output())


def test_ctrl_c_in_the_middle_of_work_is_quiet_and_every_pair_that_came_is_answered(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    num_pairs = 40
    with Bench(tmp_path, own_domain_id(63), {"preset": "lidar_indoor", "process_every": "true"}) as bench:
        for k in range(num_pairs):
            shift = 0.001 * k
            bench.player.publish(cloud(SCANS[1] + shift, k + 1), cloud(SCANS[0] + shift, k + 1))
            bench.pause(0.01)
        assert spin_until(bench.executor, lambda: bench.status()["jobs"]["received"] == num_pairs, PATIENCE_S)

        def interrupt() -> None:
            bench.process.interrupt()
            bench.process.interrupt()  # a terminal and `ros2 launch` both send one

        watch = time_to_end(bench.process.pid, lambda: bench.process.exit_code is not None, interrupt)
        assert bench.process.exit_code == 0
        bench.pause(1.0)
        # All are answered, as far as the two seconds to end in allow: less where other programs have the processors.
        stamps = [decision["source_stamp"] for decision in bench.answers.decisions]
        assert len(set(stamps)) == len(stamps)
        assert len(stamps) == num_pairs or watch.others_s > MUCH_S, f"{len(stamps)} of {num_pairs}, {watch}"
        assert_quiet(bench.process.output())
