"""Loops of simulated drives: right ones where the way leads back, and to what is still in sight; no wrong one."""

from __future__ import annotations

from pathlib import Path

import pytest

from svc_ros.core.config import preset
from svc_ros.replay.job import ReplayJob
from svc_ros.replay.run import replay_bag
from svc_ros.simulation import DriveConfig, simulate_drive

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("scene", "sensor", "preset_name", "seed", "returns", "least"),
    [
        pytest.param("indoor", "OS0-64", "lidar_indoor", 0, True, 16, id="corridor-and-back"),
        pytest.param("indoor", "OS0-64", "lidar_indoor", 1, False, 20, id="corridor-one-way"),
        pytest.param("street", "OS1-64", "lidar_outdoor", 0, True, 20, id="street-and-back"),
    ],
)
def test_right_loops_are_accepted_and_no_wrong_one(
    tmp_path: Path, scene: str, sensor: str, preset_name: str, seed: int, returns: bool, least: int
) -> None:
    pytest.importorskip("gtsam", reason="gtsam not installed: pip install 'svc_ros[graph]'")
    drive = DriveConfig(scene=scene, sensor=sensor, num_scans=60, rate_hz=1.0, seed=seed, there_and_back=returns)
    simulated = simulate_drive(tmp_path / "drive", drive)
    summary = replay_bag(ReplayJob(
        Path(simulated.bag), tmp_path / "out", preset(preset_name), preset_name, "loop_closure",
        reference=Path(simulated.reference), report=False,
    ))  # fmt: skip
    assert summary["false_loops"] == 0
    assert summary["verdicts"]["accepted"] >= least
    if not returns:  # such loops say what odometry says
        return
    errors = [summary["reference"], summary["reference"]["optimized"]]
    before, after = (numbers["ape"]["translation_m"]["rmse"] for numbers in errors)
    assert after <= before
