"""The demo, shortened: three processes, one drive with a jump."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from yardstick import PATIENCE_S

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.io.results import read_jsonl
from svc_ros.ros import demo
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id

pytestmark = [pytest.mark.dds, pytest.mark.slow]


def test_demo_leaves_every_decision_and_a_picture(tmp_path):
    command = [sys.executable, "-m", "svc_ros.ros.demo", "--out", str(tmp_path / "demo"), "--scans", "4"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert run.returncode == 0, run.stdout + run.stderr
    records = read_jsonl(tmp_path / "demo" / "decisions.jsonl")
    assert [r["verdict"] == "accepted" for r in records] == [True, False, True]
    assert all(r["translation_error_m"] < 0.1 for r in records if r["verdict"] == "accepted")
    assert all(np.all(np.diag(r["covariance"]) > 0) for r in records if r["verdict"] == "accepted")
    assert (tmp_path / "demo" / "results.mcap").stat().st_size > 1000
    assert (tmp_path / "demo" / "overview.png").read_bytes().startswith(b"\x89PNG")
    assert "low_overlap" in run.stdout or "sight_view_blocked" in run.stdout


def test_interrupted_demo_leaves_no_process(tmp_path):
    environment = local_environment(own_domain_id(8))
    with ChildProcess(
        "svc_ros.ros.demo", ["--out", str(tmp_path), "--scans", "4"], environment, tmp_path / "log"
    ) as run:
        for _ in range(600):
            if (tmp_path / "node.log").exists() or run.wait(0.1) is not None:
                break
        run.wait(1.0)
        run.interrupt()
        assert run.wait(PATIENCE_S) == 1, run.output()
        assert "interrupted" in run.output()
    processes = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout
    assert str(tmp_path) not in processes


@pytest.mark.parametrize("scans", [1, 2, 3])
def test_drive_too_short_for_its_jump_is_refused(tmp_path, scans, capsys):
    assert demo.main(["--out", str(tmp_path), "--scans", str(scans)]) == 1
    assert "at least 4" in capsys.readouterr().out
