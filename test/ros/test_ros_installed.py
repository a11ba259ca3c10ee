"""The node from the tree that colcon installs, started as `ros2 run` starts it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")
pytest.importorskip("colcon_core", reason="colcon not installed: pip install 'svc_ros[test]'")
pytest.importorskip("colcon_ros", reason="colcon-ros not installed: pip install 'svc_ros[test]'")

from pages import README
from places import NOT_COPIED, PROJECT_ROOT
from yardstick import PATIENCE_S, time_to_end

from svc_ros.ros.processes import local_environment, own_domain_id

pytestmark = [pytest.mark.dds, pytest.mark.slow]


@pytest.fixture(scope="module")
def prefix(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(PROJECT_ROOT, folder / "src" / "svc_ros", ignore=NOT_COPIED)
    environment = {**os.environ, "COLCON_HOME": str(folder / "home"), "PYTHONWARNINGS": "ignore"}
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"
    script = "\n".join([*workspace_commands(), 'printf "%s" "$AMENT_PREFIX_PATH" > found'])
    command = ["bash", "-e", "-c", script]
    built = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert built.returncode == 0, built.stdout + built.stderr
    return Path((folder / "found").read_text("utf-8").split(":")[0])  # where `ros2 run` looks


def workspace_commands() -> list[str]:
    """What the README says to build the workspace and to source it."""
    lines = [line for line in README.splitlines() if line.startswith(("python -m colcon", "source install/"))]
    assert len(lines) == 2
    return lines


@pytest.mark.parametrize("parameters", [[], ["-p", "mode:=scan_matching", "--params-file", "lidar_indoor.yaml"]])
def test_the_installed_executable_is_ready_and_ends_with_ctrl_c(prefix, tmp_path, parameters):
    (packages,) = prefix.glob("lib/python3*/site-packages")
    shared = str(prefix / "share/svc_ros/config")
    parameters = [f"{shared}/{word}" if word.endswith(".yaml") else word for word in parameters]
    environment = {**local_environment(own_domain_id(97)), "PYTHONPATH": str(packages)}
    log = tmp_path / "log"
    with log.open("wb") as out:
        node = subprocess.Popen(
            [str(prefix / "lib/svc_ros/registration_node"), "--ros-args", *parameters],
            cwd=tmp_path, env=environment, stdout=out, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            end = time.monotonic() + PATIENCE_S
            while "ready:" not in log.read_text("utf-8") and node.poll() is None and time.monotonic() < end:
                time.sleep(0.1)
            assert "ready:" in log.read_text("utf-8"), log.read_text("utf-8")
            maps = Path(f"/proc/{node.pid}/cmdline").read_text("utf-8")
            assert str(prefix) in maps
            watch = time_to_end(node.pid, lambda: node.poll() is not None, lambda: node.send_signal(signal.SIGINT))
            assert node.returncode == 0
            assert watch.own_s < 2.0, watch
        finally:
            node.kill()
            node.wait()
    text = log.read_text("utf-8")
    expected = "scan_matching, preset lidar_indoor" if parameters else "pair, preset lidar_outdoor"
    assert re.search(f"ready: mode {expected}", text), text


def test_the_workspace_as_documented_has_what_ros2_run_looks_for(prefix):
    assert prefix.parts[-2:] == ("install", "svc_ros")
    for name in ("registration_node", "bag_player"):
        assert os.access(prefix / "lib/svc_ros" / name, os.X_OK), name


def test_the_installed_package_is_what_runs(prefix, tmp_path):
    (packages,) = prefix.glob("lib/python3*/site-packages")
    environment = {**os.environ, "PYTHONPATH": str(packages)}
    code = "import svc_ros.ros.node as n; print(n.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.stdout.startswith(str(packages)), done.stdout + done.stderr
