"""A small run with right and wrong poses of simulated scans, as a replay leaves it in a folder."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

import numpy as np
from synthetic import street_pair

from svc_ros.core.config import preset, with_values
from svc_ros.core.registration import prepare, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import PreparedScan
from svc_ros.io.config_yaml import config_to_yaml
from svc_ros.io.results import result_to_json, write_jsonl
from svc_ros.io.trajectories import Trajectory, write_tum
from svc_ros.report.scenes import Scene, make_scene

DATA = re.compile(r'<script id="report-data" type="application/json">(.*?)</script>', re.DOTALL)
PRESET = "lidar_outdoor"
START_NS = 1_700_000_000_000_000_000
REJECTED, REFUSED = 1, 4  # lines of the run: a pose that sight lines contradict, a scan that could not be used


@lru_cache(maxsize=1)
def judged() -> tuple[PreparedScan, PreparedScan, tuple[RegistrationResult, ...]]:
    """(source, target, results): accepted, rejected (turned by half a circle), accepted, rejected without a pose."""
    config = preset(PRESET)
    source, target, T = street_pair()
    source_scan, target_scan = prepare(source, config), prepare(target, config)
    right = verify(source_scan, target_scan, T, config)
    far = {"shortlist.max_moved_translation_m": 100.0, "shortlist.max_moved_rotation_deg": 180.0}
    anywhere = with_values(config, far)  # refinement may move it, so that sight lines are what judges it
    wrong = verify(source_scan, target_scan, T @ np.diag([-1.0, -1.0, 1.0, 1.0]), anywhere)
    nothing = RegistrationResult(Verdict.REJECTED, Reason.NO_HYPOTHESIS, "svc", probability=0.0, detail="none agrees")
    assert right.accepted
    assert wrong.reason is Reason.SIGHT_VIEW_BLOCKED
    return source_scan, target_scan, (right, wrong, right, nothing)


def write_run(folder: Path) -> list[Scene]:
    """Write decisions.jsonl, summary.json, trajectory_tum.txt and config.yaml; returns the scenes of four decisions."""
    source, target, results = judged()
    refused = RegistrationResult(Verdict.REJECTED, Reason.TOO_FEW_POINTS, "svc", detail="3 points </script><b>")
    records = [
        result_to_json(result, source_stamp_ns=START_NS + (k + 1) * 10**9, target_stamp_ns=START_NS + k * 10**9)
        for k, result in enumerate((*results, refused))
    ]
    write_jsonl(folder / "decisions.jsonl", records)
    (folder / "summary.json").write_text(json.dumps({"bag": "/bags/street", "real_time_factor": 2.5}))
    (folder / "config.yaml").write_text(config_to_yaml(preset(PRESET), PRESET))
    write_tum(folder / "trajectory_tum.txt", way(len(records) + 1))
    return [make_scene(k, source, target, result) for k, result in enumerate(results)]


def way(num: int, step_m: float = 4.0) -> Trajectory:
    """A bent way, a pose a second."""
    poses = np.tile(np.eye(4), (num, 1, 1))
    poses[:, 0, 3] = step_m * np.arange(num)
    poses[:, 1, 3] = 0.3 * np.arange(num) ** 2
    return Trajectory(START_NS + np.arange(num, dtype=np.int64) * 10**9, poses)


def data_of(page: Path) -> dict:
    (text,) = DATA.findall(page.read_text("utf-8"))
    return json.loads(text)
