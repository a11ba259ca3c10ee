"""Clouds of millions of points: registered like those that were thinned before, in bounded memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import PROJECT_ROOT
from yardstick import PATIENCE_S

from svc_ros.core.config import preset
from svc_ros.core.registration import prepare, register
from svc_ros.core.scan import Scan

CONFIG = preset("lidar_indoor")
IN_A_PROCESS = """
import sys
from svc_ros.core.config import preset
from svc_ros.core.registration import register
from svc_ros.io.clouds.files import read_scan
target, source = (read_scan(path) for path in sys.argv[1:])
result = register(source, target, preset("lidar_indoor"))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(result.verdict.value, peak.split()[1])
"""


def hall(num: int, place: float) -> np.ndarray:
    """About num points (N, 3) [m] of a hall of 20 x 14 x 5 m with pillars, seen from a place along x [m]."""
    rows = int(np.sqrt(num / 5.0))
    elevation = np.radians(np.linspace(-40.0, 40.0, rows))
    azimuth = np.radians(np.linspace(-179.99, 180.01, num // rows, endpoint=False))
    level, up = np.stack([np.cos(azimuth), np.sin(azimuth)]), np.tan(elevation)
    sensor = np.array([place, 0.0, 1.5])
    walls = np.min([(np.sign(level[k]) * half - sensor[k]) / level[k] for k, half in ((0, 10.0), (1, 7.0))], axis=0)
    for x, y, half in ((4.0, 2.0, 0.8), (-5.0, -3.0, 1.2), (2.0, -5.0, 0.5), (-7.0, 4.0, 0.6)):
        along = (x - sensor[0]) * level[0] + (y - sensor[1]) * level[1]
        aside = np.abs((x - sensor[0]) * level[1] - (y - sensor[1]) * level[0])
        face = along - np.sqrt(np.maximum(half**2 - aside**2, 0.0))
        walls = np.where((aside < half) & (along > 0), np.minimum(walls, face), walls)
    flat = np.where(up[:, None] < 0, np.minimum(walls, -1.5 / np.minimum(up[:, None], -1e-9)), walls)
    flat = np.where(up[:, None] > 0, np.minimum(flat, 3.5 / np.maximum(up[:, None], 1e-9)), flat)
    noisy = flat * (1.0 + 1e-3 * np.random.default_rng(round(10 * place)).normal(size=flat.shape))
    return np.stack([noisy * level[0], noisy * level[1], noisy * up[:, None]], axis=-1).reshape(-1, 3)


def test_a_dense_cloud_is_as_good_as_one_thinned_before() -> None:
    scans = [Scan(hall(300_000, place)) for place in (0.0, 0.5)]
    thinned = [Scan(prepare(scan, CONFIG).points) for scan in scans]
    result, before = register(scans[1], scans[0], CONFIG), register(thinned[1], thinned[0], CONFIG)
    for found in (result, before):
        assert found.accepted
        assert np.linalg.norm(found.T_target_source[:3, 3] - [0.5, 0.0, 0.0]) < 0.1


@pytest.mark.slow
def test_five_million_points_in_bounded_memory(tmp_path: Path) -> None:
    files = [tmp_path / "target.npy", tmp_path / "source.npy"]
    for file, place in zip(files, (0.0, 0.5), strict=True):
        np.save(file, hall(5_000_000, place).astype(np.float32))
    command = [sys.executable, "-c", IN_A_PROCESS, *map(str, files)]
    done = subprocess.run(command, cwd=PROJECT_ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    verdict, peak_kb = done.stdout.split()
    assert (verdict, int(peak_kb) < 1_500_000) == ("accepted", True), peak_kb
