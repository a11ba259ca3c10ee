"""Descriptors of installed packages, in processes of their own: the example that pip installs, and one of real data."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import mini_data
import numpy as np
import pytest
from assertions import assert_same_pose
from correspondence_cases import KITTI_PAIRS, read_kitti_case
from descriptor_packages import EXAMPLE, install_example, write_package
from places import PROJECT_ROOT, SUPPORT
from scan_cases import real_pair

from svc_ros.core import se3
from svc_ros.core.config import preset, with_values
from svc_ros.core.matches import descriptors as stage
from svc_ros.core.matches.descriptors import more_matches
from svc_ros.core.registration import prepare, register
from svc_ros.core.scan import Features, Scan
from svc_ros.io.clouds.files import read_scan


@pytest.fixture(scope="module")
def example(tmp_path_factory) -> Path:
    """Where pip has put the example package."""
    return install_example(tmp_path_factory.mktemp("example"))


@pytest.fixture
def fresh_names():
    """Functions that were loaded by name are forgotten before and after."""
    stage._load.cache_clear()
    yield
    stage._load.cache_clear()


def run(site: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A Python that finds the packages of a folder beside its own."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(PROJECT_ROOT), str(site)])}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)


def write_config(path: Path, names: str, first_points: int = 0) -> Path:
    path.write_text(f"matching:\n  more_descriptors: {names}\n  first_points: {first_points}\n")
    return path


def registration_of(done: subprocess.CompletedProcess[str], path: Path) -> dict[str, object]:
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text())["registration"]


PROGRAM = """
import json
from mini_data import POSES, scan_room
from scan_cases import room_config
from svc_ros import Scan, register
config = room_config(matching__more_descriptors="spin_images", matching__first_points=0)
result = register(*(Scan(scan_room(POSES[k], seed=k)) for k in (1, 0)), config)
print(json.dumps([result.T_target_source.tolist(), result.counts]))
"""


@pytest.mark.slow
def test_the_example_joins_register(example):
    program = f"import sys\nsys.path.append({str(SUPPORT)!r})\n{PROGRAM}"
    done = run(example, "-c", program)
    assert done.returncode == 0, done.stderr
    T, counts = json.loads(done.stdout)
    assert_same_pose(T, mini_data.pose_between(1, 0), 0.5, 0.05)
    assert counts["more_correspondences"] > 300
    assert counts["correspondences"] > counts["more_correspondences"]


@pytest.mark.slow
def test_the_example_joins_evaluate_also_over_processes(example, tmp_path):
    folder = mini_data.write_dataset(tmp_path / "room")
    config = write_config(tmp_path / "mine.yaml", "spin_images, fpfh_wide")
    for workers in (1, 2):
        out = tmp_path / f"{workers}.json"
        evaluate = ("-m", "svc_ros", "evaluate", folder, "--config", config, "--workers", workers, "--json", out)
        report = registration_of(run(example, *evaluate), out)
        assert report["num_correct_accepted"] == 2
        assert report["num_false_accepted"] == 0
        assert [pair["reason"] for pair in report["pairs"]] == ["ok", "ok", "too_few_points"]
    stages = json.loads((tmp_path / "1.json").read_text())["time_ms"]["stages_p50"]
    assert stages["more_matches"] > 0


def test_the_command_line_tells_what_is_not_installed_before_it_begins(example, tmp_path):
    folder = mini_data.write_dataset(tmp_path / "room")
    config = write_config(tmp_path / "mine.yaml", "spin_image")
    for command in (("evaluate", folder), ("register", folder / "scans/1.bin", folder / "scans/0.bin"), ("config",)):
        done = run(example, "-m", "svc_ros", *command, "--config", config)
        assert done.returncode == 2
        assert done.stdout == ""
        (line,) = done.stderr.splitlines()
        assert line.startswith("error: matching.more_descriptors: unknown name 'spin_image'")
        assert "did you mean 'spin_images'?" in line
        assert "svc_ros.descriptors" in line
    good = write_config(tmp_path / "good.yaml", "spin_images")
    assert "more_descriptors: spin_images" in run(example, "-m", "svc_ros", "config", "--config", good).stdout


def test_the_example_describes_recorded_scans_better_than_chance(shared_data, monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLE))
    from svc_ros_spin_images import describe

    monkeypatch.setattr(stage, "load_descriptors", lambda config: {"spin_images": describe})
    for name, least in (("os0_64_walk", 0.2), ("hdl64_city", 0.05)):
        source, target, T, config = real_pair(shared_data, name, 3)
        (found,) = more_matches(prepare(source, config), prepare(target, config), config)
        residual = np.linalg.norm(se3.apply(T, found.source_points) - found.target_points, axis=1)
        assert (residual < 0.6).mean() > least, name


def test_the_page_shows_the_example_as_it_is():
    page = (PROJECT_ROOT / "docs" / "descriptors.md").read_text("utf-8")
    for name, language in (("pyproject.toml", "toml"), ("svc_ros_spin_images.py", "python")):
        assert f"```{language}\n{(EXAMPLE / name).read_text('utf-8')}```\n" in page, name


CORRESPONDENCES_OF_FILES = """
import os
import numpy as np
from svc_ros import Description

def describe(scan, config):
    points = np.load(os.path.join(os.environ["SVC_ROS_TEST_CORRESPONDENCES"], scan.frame_id + "_corr.npy"))
    return Description(points, np.random.default_rng(0).normal(size=(6000, 32))[: len(points)])  # row k is row k
"""


@pytest.mark.parametrize(
    "pair", [p if k < 4 else pytest.param(p, marks=pytest.mark.slow) for k, p in enumerate(KITTI_PAIRS)]
)
def test_real_correspondences_come_through_a_description(shared_data, pair, tmp_path, monkeypatch, fresh_names):
    """Row k of the source looks like row k of the target and like nothing else; FPFH is not asked at all."""
    folder = shared_data / "correspondences" / "kitti_10m_fpfh"
    write_package(tmp_path, "of_files", CORRESPONDENCES_OF_FILES, of_files="describe")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("SVC_ROS_TEST_CORRESPONDENCES", str(folder))
    values = {"matching.more_descriptors": "of_files", "matching.max_correspondences": 6000,
              "hypotheses.levelled_poses": 0}  # fmt: skip
    config = with_values(preset("lidar_outdoor"), values)
    source, target = (undescribed(folder, f"{pair}_{side}", config) for side in ("src", "dst"))
    given, T = read_kitti_case(shared_data, pair)
    (found,) = more_matches(source.prepared, target.prepared, config)
    for one, other in ((found.source_points, given.source_points), (found.target_points, given.target_points)):
        np.testing.assert_array_equal(one, other)  # all of them, in the source's order
    result = register(source, target, config)
    assert result.counts["correspondences"] == result.counts["more_correspondences"] == len(given)
    assert result.accepted, result.detail
    assert_same_pose(result.T_target_source, T, 1.0, 0.6)


def undescribed(folder: Path, name: str, config) -> Features:
    """A scan whose frame is its name, in which FPFH matches nothing."""
    scan = prepare(Scan(read_scan(folder / f"{name[:3]}_pts_{name[4:]}.ply").points, frame_id=name), config)
    return Features(scan, np.zeros((len(scan), 0), np.float32))
