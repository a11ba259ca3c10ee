"""What `svc_ros doctor` finds out: about machines that lack something, and about bags that are odd in one way each."""

from __future__ import annotations

import builtins
import ctypes
import importlib
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_recorder import CLOUD, START, Recorder, S, record
from cloud_messages import Cloud, Column, Layout, pack, xyz_cloud, xyz_columns
from command_line import run
from places import PROJECT_ROOT

from svc_ros.cli.doctor import installation as doctor
from svc_ros.cli.doctor.installation import Finding, check_bag, check_installation
from svc_ros.core.errors import InputError
from svc_ros.io.config_yaml import write_preset_files
from svc_ros.simulation import DriveConfig, simulate_drive

BALL = np.random.default_rng(1).normal(size=(300, 3)) * 8.0
NAN_FREE = xyz_cloud(BALL)
ALONE = {"/points number of clouds"}  # what a bag of one cloud is told besides


def named(findings: list[Finding], name: str) -> Finding:
    found = [finding for finding in findings if finding.name == name]
    assert len(found) == 1, f"{name}: {[f.name for f in findings]}"
    return found[0]


def bag_of(path: Path, *clouds: tuple[int, Cloud], frames: tuple[tuple[str, str], ...] = ()) -> Path:
    """A bag of clouds at bag times [s after START] and static transforms."""

    def fill(recorder: Recorder) -> None:
        for parent, child in frames:
            recorder.transform("/tf_static", START, (parent, child), (0, 0, 1.5, 0, 0, 0, 1))
        for seconds, cloud in clouds:
            recorder.write("/points", CLOUD, START + seconds * S, cloud.message())

    return record(path / "bag", "mcap", fill)


def cloud_at(seconds: float, points: Any = BALL, frame: str = "lidar") -> Cloud:
    return xyz_cloud(points, START + round(seconds * S), frame)


def three_good(path: Path, frames: tuple[tuple[str, str], ...] = ()) -> Path:
    return bag_of(path, *((k, cloud_at(k, BALL + 0.01 * k)) for k in range(3)), frames=frames)


class TestInstallation:
    def test_this_environment_has_what_is_required(self) -> None:
        findings = check_installation()
        assert [f for f in findings if f.level == "error"] == []
        required = {"Python", "numpy", "scipy", "numba", "open3d", "kiss_icp", "small_gicp", "rosbags", "yaml"}
        assert required <= {f.name for f in findings}
        assert named(findings, "numpy").found == np.__version__

    def test_a_missing_package_comes_with_its_command(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "rosbags", None)
        finding = named(check_installation(), "rosbags")
        assert finding.level == "error"
        assert "pip install 'rosbags>=0.11'" in finding.advice

    def test_a_missing_optional_package_is_no_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "laspy", None)
        finding = named(check_installation(), "laspy")
        assert (finding.level, "laspy[lazrs]" in finding.advice) == ("warn", True)

    def test_open3d_without_its_library_names_library_and_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        real = importlib.import_module

        def refuse(name: str, package: str | None = None) -> Any:
            if name == "open3d":
                raise OSError("libGL.so.1: cannot open shared object file: No such file or directory")
            return real(name, package)

        monkeypatch.setattr(importlib, "import_module", refuse)
        finding = named(check_installation(), "open3d")
        assert finding.level == "error"
        assert "libGL.so.1" in finding.found
        assert finding.advice == "apt-get install libgl1"

    @pytest.mark.parametrize(("open3d_works", "level"), [(True, "warn"), (False, "error")])
    def test_missing_system_libraries(self, monkeypatch: pytest.MonkeyPatch, open3d_works: bool, level: str) -> None:
        def load(name: str) -> None:
            if name == "libEGL.so.1":
                raise OSError(name)

        monkeypatch.setattr(ctypes, "CDLL", load)
        monkeypatch.setattr(doctor.platform, "system", lambda: "Linux")
        (finding,) = doctor.check_system_libraries(open3d_works)
        assert (finding.name, finding.level) == ("libEGL.so.1", level)
        assert finding.advice == "apt-get install libegl1"

    def test_presets_are_read_from_the_folder(self, tmp_path: Path) -> None:
        write_preset_files(tmp_path)
        assert {f.level for f in doctor.check_presets(tmp_path)} == {"ok"}
        (tmp_path / "lidar_indoor.yaml").write_text("preprocess: {voxel_size_metre: 1.0}\n")
        (tmp_path / "rgbd_indoor.yaml").unlink()
        findings = doctor.check_presets(tmp_path)
        broken = named(findings, "preset lidar_indoor")
        assert broken.level == "error"
        assert "voxel_size_metre" in broken.found
        assert named(findings, "preset rgbd_indoor").level == "warn"


class TestRos:
    def make_rclpy(self, folder: Path, wheel: bool, works: bool = True) -> str:
        (folder / "rclpy").mkdir(parents=True)
        (folder / "rclpy" / "__init__.py").write_text("" if works else "raise ImportError('librcl.so')")
        if wheel:
            (folder / "ros_rclpy-7.1.6.dist-info").mkdir()
        return str(folder)

    @pytest.fixture(autouse=True)
    def _no_ros_sourced(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
        monkeypatch.setattr(doctor, "_import_problem", lambda module: "")

    def test_none(self, tmp_path: Path) -> None:
        (finding,) = doctor.check_ros([str(tmp_path)])
        assert (finding.level, "svc_ros[ros]" in finding.advice) == ("warn", True)

    def test_wheels_alone(self, tmp_path: Path) -> None:
        (finding,) = doctor.check_ros([self.make_rclpy(tmp_path, wheel=True)])
        assert (finding.level, "from wheels" in finding.found) == ("ok", True)

    def test_two_on_the_search_path_are_an_error(self, tmp_path: Path) -> None:
        path = [self.make_rclpy(tmp_path / "a", wheel=True), self.make_rclpy(tmp_path / "b", wheel=False)]
        (finding,) = doctor.check_ros(path)
        assert finding.level == "error"
        assert str(tmp_path / "a") in finding.found
        assert str(tmp_path / "b") in finding.found

    def test_wheels_under_a_sourced_ros_are_an_error(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.make_rclpy(tmp_path / "jazzy" / "lib" / "python3.12" / "site-packages", wheel=False)
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "jazzy"))
        (finding,) = doctor.check_ros([self.make_rclpy(tmp_path / "venv", wheel=True)])
        assert (finding.level, str(tmp_path / "jazzy") in finding.found) == ("error", True)

    def test_a_workspace_without_an_rclpy_is_no_second_ros(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install" / "svc_ros"))
        (finding,) = doctor.check_ros([self.make_rclpy(tmp_path / "venv", wheel=True)])
        assert finding.level == "ok"

    def test_numpy_2_beside_apt_packages_is_a_warning(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(doctor.metadata, "version", lambda name: "2.1.0")
        home = self.make_rclpy(tmp_path, wheel=False)
        assert named(doctor.check_ros([home]), "numpy beside ROS").level == "warn"

    def test_an_inherited_guard_is_named(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(doctor, "_import_problem", lambda module: "ImportError: librcl.so")
        monkeypatch.setenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
        monkeypatch.setenv("LD_LIBRARY_PATH", "/elsewhere")
        (finding,) = doctor.check_ros([self.make_rclpy(tmp_path, wheel=True)])
        assert finding.level == "error"
        assert "unset _ROS_WHEELS_BOOTSTRAP_COMPLETE" in finding.advice


def test_import_in_a_python_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "quarrelsome.py").write_text("raise ImportError('libfoo.so is missing')")
    assert doctor._import_problem("quarrelsome") == "ImportError: libfoo.so is missing"
    assert doctor._import_problem("json") == ""


class TestBag:
    def test_a_good_bag_has_nothing_to_complain_about(self, tmp_path: Path) -> None:
        findings = check_bag(three_good(tmp_path, frames=(("base", "lidar"),)))
        assert {f.level for f in findings} == {"ok"}
        assert named(findings, "topic /points").found == f"{CLOUD}, 3 messages"
        assert named(findings, "/points fields").found == "x float32, y float32, z float32; 12 bytes a point"
        assert named(findings, "/points points").found.startswith("300 a cloud")
        assert "1.0 Hz" in named(findings, "/points stamps").found
        assert "base 100%" in named(findings, "/points transforms of lidar").found

    def test_a_frame_without_transforms_is_a_warning(self, tmp_path: Path) -> None:
        findings = check_bag(three_good(tmp_path, frames=(("map", "camera"),)))
        finding = named(findings, "/points transforms of lidar")
        assert finding.level == "warn"
        assert "camera, map" in finding.found

    def test_shares_of_nan_and_zero_points(self, tmp_path: Path) -> None:
        points = BALL.copy()
        points[:225] = np.nan
        points[225:240] = 0.0
        findings = check_bag(bag_of(tmp_path, (0, cloud_at(0, points))))
        assert (named(findings, "/points NaN share").level, named(findings, "/points NaN share").found) == (
            "warn", "75.0%",
        )  # fmt: skip
        assert named(findings, "/points zero-point share").found == "5.0%"

    def test_empty_clouds_are_counted(self, tmp_path: Path) -> None:
        findings = check_bag(bag_of(tmp_path, (0, cloud_at(0)), (1, cloud_at(1, np.empty((0, 3))))))
        finding = named(findings, "/points points")
        assert (finding.level, "1 clouds empty" in finding.found) == ("warn", True)

    def test_stamps_backwards_repeated_and_with_a_gap(self, tmp_path: Path) -> None:
        seconds = [0.0, 0.1, 0.2, 0.2, 0.3, 0.4, 1.4, 1.3]
        bag = bag_of(tmp_path, *((round(s), cloud_at(s)) for s in seconds))
        findings = check_bag(bag)
        assert named(findings, "/points stamp order").found == "1 backwards"
        assert named(findings, "/points stamp repeats").found == "1 duplicates"
        assert named(findings, "/points stamp gaps").found == "1 gaps, the longest 1.000 s"

    def test_stamps_of_zero_are_an_error(self, tmp_path: Path) -> None:
        findings = check_bag(bag_of(tmp_path, *((k, replace(NAN_FREE, stamp_ns=0)) for k in range(2))))
        assert named(findings, "/points stamps").level == "error"

    def test_header_time_of_another_clock(self, tmp_path: Path) -> None:
        findings = check_bag(bag_of(tmp_path, *((k, cloud_at(k - 100)) for k in range(3))))
        finding = named(findings, "/points header and bag time")
        assert (finding.level, "+100.000 s" in finding.found) == ("warn", True)

    def test_some_broken_clouds_warn_and_only_broken_ones_are_an_error(self, tmp_path: Path) -> None:
        broken = replace(cloud_at(1), data=b"\0" * 12)
        some = named(check_bag(bag_of(tmp_path / "some", (0, cloud_at(0)), (1, broken))), "/points fields")
        assert some.level == "warn"
        assert "1 of 2 clouds refused" in some.found
        assert "truncated" in some.found
        assert named(check_bag(bag_of(tmp_path / "all", (1, broken))), "/points fields").level == "error"

    def test_frames_that_change_or_have_no_name(self, tmp_path: Path) -> None:
        two = check_bag(bag_of(tmp_path / "two", (0, cloud_at(0, frame="left")), (1, cloud_at(1, frame="right"))))
        assert (named(two, "/points frame").level, named(two, "/points frame").found) == ("warn", "left, right")
        assert named(check_bag(bag_of(tmp_path / "no", (0, cloud_at(0, frame="")))), "/points frame").level == "error"

    def test_a_bag_without_clouds(self, tmp_path: Path) -> None:
        assert named(check_bag(bag_of(tmp_path, frames=(("a", "b"),))), "clouds").level == "error"

    def test_bad_input_is_an_exception_that_names_it(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"nothing\.bag"):
            check_bag(tmp_path / "nothing.bag")
        with pytest.raises(InputError, match="/points"):
            check_bag(three_good(tmp_path), topic="/other")

    @pytest.mark.parametrize(
        ("reach_m", "wanted"), [(4.0, "rgbd_indoor"), (20.0, "lidar_indoor"), (70.0, "lidar_outdoor")]
    )
    def test_suggested_preset(self, tmp_path: Path, reach_m: float, wanted: str) -> None:
        rng = np.random.default_rng(2)
        directions = rng.normal(size=(2000, 3))
        if reach_m < 8.0:
            directions = np.array([0.0, 0.0, 1.0]) + 0.2 * directions  # a camera looks one way
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        cloud = cloud_at(0, directions * rng.uniform(0.5, reach_m, (2000, 1)))
        assert named(check_bag(bag_of(tmp_path, (0, cloud))), "/points preset").found.startswith(wanted)

    @pytest.mark.parametrize(
        ("bag", "topic", "wanted"),
        [
            ("os0_64_walk/ros2_mcap", "/points", "lidar_indoor"),
            ("os0_64_walk/ros1_first22.bag", "/points", "lidar_indoor"),
            ("hdl64_kitti_a_10hz", "/velodyne_points", "lidar_outdoor"),
        ],
    )
    def test_real_bags(self, shared_data: Path, bag: str, topic: str, wanted: str) -> None:
        findings = check_bag(shared_data / "bags" / bag)
        assert {f.level for f in findings} == {"ok"}
        assert named(findings, f"{topic} preset").found.startswith(wanted)


def sphere(num: int, radius_m: float, seed: int = 3) -> np.ndarray:
    """Points (num, 3) all around, one range in every direction."""
    directions = np.random.default_rng(seed).normal(size=(num, 3))
    return radius_m * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def two_walls(sensor: tuple[float, float, float]) -> np.ndarray:
    """What a sensor sees of two rows of pillars, in the frame of the world (N, 3)."""
    angles = np.radians(np.arange(-60.0, 60.0, 0.1) + 0.03)
    pillars = np.where(np.arange(len(angles)) // 100 % 2 == 0, 6.0, 12.0)
    x, y = pillars * np.array([np.cos(angles), np.sin(angles)])
    rows = [np.array([x, y, pillars * np.tan(h)]).T for h in np.radians(np.arange(-9.9, 10.0, 0.4))]
    return np.vstack(rows) + sensor


def timed_cloud(seconds: float, times: np.ndarray) -> Cloud:
    points = sphere(len(times), 20.0)
    cloud = pack([*xyz_columns(points), Column("time", times.tolist())])
    return replace(cloud, stamp_ns=START + round(seconds * S))


class TestFaults:
    """One fault a bag, and the line that names it."""

    def finding(self, path: Path, name: str, *clouds: tuple[int, Cloud]) -> Finding:
        return named(check_bag(bag_of(path, *clouds)), f"/points {name}")

    @pytest.mark.parametrize(
        ("type_name", "advice"), [("sensor_msgs/msg/LaserScan", "a plane of points"), ("std_msgs/msg/String", "record")]
    )
    def test_scans_that_are_no_clouds(self, tmp_path: Path, type_name: str, advice: str) -> None:
        def fill(recorder: Recorder) -> None:
            if type_name.endswith("String"):
                recorder.write("/scan", type_name, START, recorder.make(type_name, data="no scan"))
                return
            numbers = dict.fromkeys(
                ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max"),
                1.0,
            )
            empty = np.zeros(0, np.float32)
            header = recorder.header(START, "laser")
            message = recorder.make(type_name, header=header, **numbers, ranges=empty, intensities=empty)
            recorder.write("/scan", type_name, START, message)

        finding = named(check_bag(record(tmp_path / "bag", "mcap", fill)), "clouds")
        assert finding.level == "error"
        assert finding.advice.startswith(advice)
        assert ("/scan" in finding.found) == type_name.endswith("LaserScan")

    def test_a_field_is_missing(self, tmp_path: Path) -> None:
        cloud = pack([Column(name, [1.0, 2.0]) for name in ("x", "y", "range")])
        finding = self.finding(tmp_path, "fields", (0, replace(cloud, stamp_ns=START)))
        assert finding.level == "error"
        assert "expected one field 'z', found 0 in: x, y, range" in finding.found

    def test_times_are_told_or_missed(self, tmp_path: Path) -> None:
        with_times = timed_cloud(0, np.linspace(0.0, 0.1, 300))
        good = self.finding(tmp_path / "good", "point times", (0, with_times))
        assert (good.level, good.found) == ("ok", "field time, a sweep lasts 0.100 s")
        none = self.finding(tmp_path / "none", "point times", (0, cloud_at(0)))
        assert (none.found, "scan_matching" in none.advice) == ("none", True)
        same = self.finding(tmp_path / "same", "point times", (0, timed_cloud(0, np.zeros(300))))
        assert (same.level, same.found) == ("warn", "field time, the same for all points")
        other = self.finding(tmp_path / "other", "point times", (0, with_times), (1, timed_cloud(1, np.full(300, 9e5))))
        assert (other.level, other.found) == ("warn", "field time, unusable in 1 of 2 clouds")

    def test_directions_without_return_are_counted(self, tmp_path: Path) -> None:
        angles = np.radians(np.arange(0.0, 360.0, 1.0))
        rings = [20.0 * np.array([np.cos(angles) * np.cos(e), np.sin(angles) * np.cos(e), np.full(360, np.sin(e))]).T
                 for e in np.radians(np.arange(-8.0, 8.0, 2.0))]  # fmt: skip
        points = np.vstack(rings)
        points[700:720] = np.inf
        cloud = pack(xyz_columns(points), Layout(height=8))
        finding = self.finding(tmp_path, "free directions", (0, replace(cloud, stamp_ns=START)))
        assert (finding.level, finding.found.endswith("from points at +inf")) == ("ok", True)

    def test_clouds_away_from_their_sensor(self, tmp_path: Path) -> None:
        here = self.finding(tmp_path / "here", "sensor at the origin", (0, cloud_at(0, two_walls((0, 0, 0)))))
        there = self.finding(tmp_path / "there", "sensor at the origin", (0, cloud_at(0, two_walls((-4.0, 15.0, 0)))))
        assert here.level == "ok"
        assert there.level == "warn"
        assert "--sensor-frame" in there.advice

    def test_a_named_sensor_frame_tells_where_the_sensor_stands(self, tmp_path: Path) -> None:
        cloud = cloud_at(0, two_walls((-4.0, 15.0, 0)), frame="map")

        def fill(recorder: Recorder) -> None:
            recorder.transform("/tf_static", START, ("map", "lidar"), (-4.0, 15.0, 0, 0, 0, 0, 1))
            recorder.write("/points", CLOUD, START, cloud.message())

        bag = record(tmp_path / "bag", "mcap", fill)
        blind, told = check_bag(bag), check_bag(bag, sensor_frame="lidar")
        assert {f.name for f in blind if f.level != "ok"} == {"/points frame", "/points sensor at the origin", *ALONE}
        assert {f.name for f in told if f.level != "ok"} == ALONE
        assert "within 12." in named(told, "/points preset").found
        wrong = named(check_bag(bag, sensor_frame="camera"), "/points sensor frame")
        assert wrong.level == "error"
        assert "unknown of 1 of 1 clouds" in wrong.found
        assert "'camera'" in wrong.found

    def test_several_sensors_in_one_cloud(self, tmp_path: Path) -> None:
        both = np.vstack([sphere(20_000, 20.0), sphere(20_000, 5.0, seed=4) + np.array([4.0, 0.0, 0.0])])
        assert self.finding(tmp_path, "sensor at the origin", (0, cloud_at(0, both))).level == "warn"

    def test_a_frame_of_the_world(self, tmp_path: Path) -> None:
        finding = self.finding(tmp_path, "frame", (0, cloud_at(0, frame="robot/map")))
        assert (finding.level, "sensor_frame" in finding.advice) == ("warn", True)

    def test_some_stamps_of_zero_do_not_spoil_the_others(self, tmp_path: Path) -> None:
        clouds = [(k, cloud_at(k, BALL + k)) for k in range(4)]
        bag = bag_of(tmp_path, *clouds, (4, replace(NAN_FREE, stamp_ns=0)))
        findings = check_bag(bag)
        assert named(findings, "/points stamps of zero").found == "1 of 5 clouds"
        assert named(findings, "/points stamps").found.endswith("1.0 Hz")
        assert not [f for f in findings if f.name in ("/points stamp order", "/points stamp gaps")]

    def test_the_same_points_again(self, tmp_path: Path) -> None:
        finding = self.finding(tmp_path, "repeated clouds", *((k, cloud_at(k)) for k in range(3)))
        assert (finding.level, finding.found) == ("warn", "2 hold the points of the one before")

    @pytest.mark.parametrize(("factor", "level"), [(1.0, "ok"), (1000.0, "error"), (1e-3, "error")])
    def test_another_unit(self, tmp_path: Path, factor: float, level: str) -> None:
        findings = check_bag(bag_of(tmp_path, (0, cloud_at(0, factor * sphere(500, 20.0)))))
        wrong = [f for f in findings if f.name == "/points scale"]
        assert ([f.level for f in wrong] or ["ok"]) == [level]
        assert not wrong or not [f for f in findings if f.name == "/points preset"]

    def test_ranges_that_the_preset_cuts(self, tmp_path: Path) -> None:
        near = np.vstack([sphere(300, 0.4), sphere(700, 15.0)])
        finding = self.finding(tmp_path / "near", "ranges", (0, cloud_at(0, near)))
        assert (finding.level, finding.found) == ("warn", "30% of the points nearer than 0.5 m, 0% beyond 60 m")
        far = self.finding(tmp_path / "far", "ranges", (0, cloud_at(0, sphere(700, 150.0))))
        assert (far.level, "100% beyond 80 m" in far.found) == ("warn", True)

    def test_too_few_points(self, tmp_path: Path) -> None:
        few = self.finding(tmp_path / "all", "points left", (0, cloud_at(0, sphere(60, 20.0))))
        assert (few.level, few.found.startswith("60 left")) == ("error", True)
        clouds = ((0, cloud_at(0, sphere(60, 20.0))), (1, cloud_at(1, sphere(500, 20.0))))
        assert self.finding(tmp_path / "some", "points left", *clouds).level == "warn"

    @pytest.mark.parametrize(("reach_m", "other"), [(25.0, "lidar_outdoor"), (45.0, "lidar_indoor"), (70.0, "")])
    def test_the_choice_is_open_near_the_border(self, tmp_path: Path, reach_m: float, other: str) -> None:
        finding = self.finding(tmp_path, "preset", (0, cloud_at(0, sphere(2000, reach_m))))
        assert finding.advice.partition("; ")[2] == (f"{other} may fit as well" if other else "")


NOTHING = np.empty((0, 3))
SEEN = two_walls((0.0, 0.0, 0.0))
UTM = np.array([5e5, 5.4e6, 300.0])
USELESS = {
    "all NaN": ([np.full((500, 3), np.nan)] * 4, "NaN share", "driver"),
    "all zero": ([np.zeros((500, 3))] * 2, "zero-point share", "driver"),
    "all at infinity": ([np.full((500, 3), np.inf)] * 2, "points", "driver"),
    "NaN and zero": ([np.vstack([np.zeros((9, 3)), np.full((9, 3), np.nan)])] * 2, "points", "driver"),
    "empty": ([NOTHING, NOTHING], "points", "driver"),
    "millimetres": ([1000.0 * SEEN] * 2, "scale", "Multiplied by 0.001 they lie within"),
    "UTM": ([SEEN + UTM] * 2, "scale", "coordinates of a map or UTM"),
    "beyond the range": ([sphere(700, 150.0)] * 2, "points left", "preprocess.max_range_m"),
    "within the least range": ([sphere(700, 0.4)] * 2, "points left", "preprocess.min_range_m"),
    "few": ([sphere(20, 10.0)] * 2, "points left", "a part of a sweep"),
    "a 2D laser": ([SEEN * [1.0, 1.0, 0.0]] * 2, "points left", "too little for a pose in 3D"),
    "a 2D laser in a hall": ([SEEN * [4.0, 4.0, 0.0]] * 2, "structure", "too little for a pose in 3D"),
    "a wall": ([np.vstack([SEEN[:, 1:].T, np.full(len(SEEN), 5.0)]).T] * 2, "structure", "more structure"),
}


class TestUselessBags:
    """Each has an error, which says what to do; none is registered, and none ends without a word."""

    @pytest.mark.parametrize("kind", USELESS)
    def test_the_content_of_clouds(self, tmp_path: Path, kind: str) -> None:
        scans, name, advice = USELESS[kind]
        findings = check_bag(bag_of(tmp_path, *((k, cloud_at(k, scan)) for k, scan in enumerate(scans))), trial=True)
        finding = named(findings, f"/points {name}")
        assert finding.level == "error"
        assert advice in finding.advice
        assert not [f for f in findings if "registration" in f.name]

    def test_no_scan_that_can_be_used_ends_with_an_error(self, tmp_path: Path) -> None:
        clouds = [(k, cloud_at(k, np.full((500, 3), np.nan))) for k in range(4)]
        result = run("doctor", bag_of(tmp_path, *clouds))
        assert result.exit_code == 2
        assert result.stderr.splitlines()[-1].endswith("checks failed: /points points, /points NaN share")

    def test_one_stamp_for_all_clouds(self, tmp_path: Path) -> None:
        findings = check_bag(bag_of(tmp_path, *((k, cloud_at(5, BALL + k)) for k in range(3))))
        finding = named(findings, "/points stamps")
        assert (finding.level, finding.found.startswith("all ")) == ("error", True)

    def test_one_scan_only(self, tmp_path: Path) -> None:
        finding = named(check_bag(bag_of(tmp_path, (0, cloud_at(0)))), "/points number of clouds")
        assert (finding.level, "record a run" in finding.advice) == ("warn", True)

    def test_intensities_without_coordinates(self, tmp_path: Path) -> None:
        cloud = replace(pack([Column("intensity", [1.0, 2.0])]), stamp_ns=START)
        finding = named(check_bag(bag_of(tmp_path, (0, cloud), (1, cloud))), "/points fields")
        assert (finding.level, "expected one field 'x'" in finding.found) == ("error", True)
        assert finding.advice

    def test_two_topics_with_clouds(self, tmp_path: Path) -> None:
        def fill(recorder: Recorder) -> None:
            for topic in ("/front", "/rear"):
                for k in range(2):
                    recorder.write(topic, CLOUD, START + k * S, cloud_at(k, BALL + k).message())

        findings = check_bag(record(tmp_path / "bag", "mcap", fill))
        finding = named(findings, "cloud topics")
        assert (finding.found, "name it" in finding.advice) == ("/front, /rear", True)
        assert {f.level for f in findings} == {"ok"}

    def test_the_samples(self, shared_data: Path) -> None:
        bags = shared_data / "inputs" / "bags"
        if not bags.is_dir():
            pytest.skip(f"no samples of useless bags in {bags}")
        for bag, name in (("only_nan", "NaN share"), ("millimetres", "scale")):
            assert named(check_bag(bags / bag, trial=True), f"/points {name}").level == "error"


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = DriveConfig("street", "OS1-64", num_scans=3, spacing_m=2.0, rate_hz=10.0)
    return simulate_drive(tmp_path_factory.mktemp("trial"), config).bag


class TestTrial:
    def test_neighbours_are_registered_and_fast_motion_is_named(self, street: Path) -> None:
        findings = check_bag(street, trial=True)
        tried = [f for f in findings if " registration, " in f.name]
        assert tried
        assert tried[-1].found.startswith("2 of 2 neighbouring pairs accepted")
        motion = named(findings, "/points motion")
        assert motion.level == "warn"
        assert motion.found.startswith("up to 20.")
        assert "in a sweep of 0.10 s" in motion.found

    def test_without_a_trial_nothing_is_registered(self, street: Path) -> None:
        assert not [f for f in check_bag(street) if "registration" in f.name or "motion" in f.name]

    def test_scans_that_have_nothing_in_common(self, tmp_path: Path) -> None:
        clouds = [(k, cloud_at(k, np.random.default_rng(k).normal(size=(2000, 3)) * 10.0)) for k in range(2)]
        findings = check_bag(bag_of(tmp_path, *clouds), trial=True)
        tried = [f for f in findings if " registration, " in f.name]
        assert [f.level for f in tried] == ["warn", "warn"]  # each LiDAR preset
        assert tried[0].found.startswith("0 of 1")
        assert not [f for f in findings if f.name == "/points motion"]

    def test_what_cannot_be_used_is_not_tried(self, tmp_path: Path) -> None:
        bag = bag_of(tmp_path, *((k, replace(NAN_FREE, stamp_ns=0)) for k in range(2)))
        assert not [f for f in check_bag(bag, trial=True) if "registration" in f.name]


@pytest.mark.parametrize(
    ("bag", "wanted"),
    [
        ("depth_ros1_padded_nan/perception_tutorial.bag", "rgbd_indoor"),
        ("os0_8_10scans_pointcloud2", "lidar_indoor"),  # between both, and the other one is named, too
        ("os1_128_pointcloud2_mcap", "lidar_outdoor"),
        ("vlp16_pointcloud2", "lidar_indoor"),
        ("vlp32_pointcloud2", "lidar_indoor"),
    ],
)
def test_bags_of_other_sensors(shared_data: Path, bag: str, wanted: str) -> None:
    findings = check_bag(shared_data / "bags" / "readers" / bag)
    assert next(f for f in findings if f.name.endswith(" preset")).found.startswith(wanted)
    odd = [f.name for f in findings if f.level != "ok" and "number of clouds" not in f.name]
    clock = ["/camera/depth_registered/points header and bag time"]
    assert odd == (clock if bag.startswith("depth") else [])


def test_the_page_has_every_line_of_a_bag() -> None:
    page = (PROJECT_ROOT / "docs" / "doctor.md").read_text("utf-8")
    told = {name for row in re.findall(r"^\| (`.+?) \|", page, re.MULTILINE) for name in re.findall(r"`([^`]+)`", row)}
    files = (PROJECT_ROOT / "svc_ros" / "cli" / "doctor").glob("*.py")
    sources = [path.read_text("utf-8") for path in files if path.stem != "installation"]
    given = {
        text.partition("{")[0].strip(" ,")
        for source in sources
        for text in re.findall(r'(?:Finding\(|_check_dropped\(|name(?:, spans)? = )f?"([^"{]+)', source)
    }
    assert given == told


def test_the_checks_print_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError(f"printed {args}")

    monkeypatch.setattr(builtins, "print", refuse)
    check_installation()
    check_bag(three_good(tmp_path))
