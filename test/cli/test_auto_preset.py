"""Preset `auto`: what it makes of real and simulated sensors, what it does not look at, and who has the last word."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import mini_data
import numpy as np
import pytest
from command_line import assert_refused, run
from test_cli import bag, scans  # noqa: F401

from svc_ros import choose_preset, preset
from svc_ros.core.auto_preset import CAMERA_REACH_M, INDOOR_REACH_M, look_out
from svc_ros.core.config import AUTO, with_values
from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Scan
from svc_ros.io.bags import Bag
from svc_ros.io.config_yaml import read_config_file
from svc_ros.io.datasets import read_dataset
from svc_ros.replay.clouds import BagPart, first_scans
from svc_ros.simulation import build_scene, sensor_model
from svc_ros.simulation.meshes import upright
from svc_ros.simulation.ray_casting import RayCaster
from svc_ros.simulation.sensor_model import T_BODY_OPTICAL

NOT_AS_TOLD = {"hdl32_easy", "hdl64_kitti_05_loop"}  # short streets: told lidar_outdoor, decided alike by lidar_indoor
BAGS = {
    "hdl64_kitti_a_10hz": "lidar_outdoor",
    "os0_64_walk/ros2_mcap": "lidar_indoor",
    "readers/vlp16_pointcloud2": "lidar_indoor",
    "readers/vlp32_pointcloud2": "lidar_indoor",
    "readers/os1_128_pointcloud2_mcap": "lidar_outdoor",
    "readers/depth_ros1_padded_nan/perception_tutorial.bag": "rgbd_indoor",
}


def around(reach_m: float, seed: int = 0, half_angle_deg: float = 180.0) -> Scan:
    """2000 points in all directions within an angle of x, at ranges up to reach_m."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(np.cos(np.radians(half_angle_deg)), 1.0, 2000)
    turn, level = rng.uniform(0.0, 2.0 * np.pi, 2000), np.sqrt(1.0 - x**2)
    directions = np.stack([x, level * np.cos(turn), level * np.sin(turn)], -1)
    return Scan(directions * rng.uniform(0.4, reach_m, (2000, 1)))


class TestRealSensors:
    @pytest.mark.parametrize("name", BAGS)
    def test_the_first_clouds_of_a_bag(self, shared_data: Path, name: str) -> None:
        with Bag(shared_data / "bags" / name) as recorded:
            found = first_scans(recorded, BagPart(recorded.resolve_cloud_topic(None)), 2)
        assert choose_preset(found).preset == BAGS[name]

    @pytest.mark.slow
    def test_every_pair_of_every_set(self, shared_data: Path) -> None:
        for folder in sorted((shared_data / "pairs").iterdir()):
            data = read_dataset(folder)
            names = dict.fromkeys(name for pair in data.pairs for name in (pair.source, pair.target))
            looks = {name: data.read_scan(name) for name in names}
            chosen = {choose_preset([looks[p.source], looks[p.target]]).preset for p in data.pairs}
            assert chosen <= {"lidar_indoor" if data.name in NOT_AS_TOLD else data.preset}, data.name


class TestSimulatedSensors:
    @pytest.mark.parametrize(
        ("scene", "sensor", "wanted"),
        [
            ("street", "VLP-16", "lidar_outdoor"), ("street", "OS1-64", "lidar_outdoor"),
            ("street", "HDL-64E", "lidar_outdoor"), ("street", "RS-M1", "lidar_outdoor"),
            ("street", "MID-40", "lidar_outdoor"), ("indoor", "VLP-16", "lidar_indoor"),
            ("indoor", "OS0-64", "lidar_indoor"), ("indoor", "HDL-32E", "lidar_indoor"),
            ("indoor", "UTM-30LX", "lidar_indoor"), ("indoor", "XTION", "rgbd_indoor"),
        ],
    )  # fmt: skip
    def test_the_surroundings_decide(self, scene: str, sensor: str, wanted: str) -> None:
        world, model = build_scene(scene, np.random.default_rng(5)), sensor_model(sensor)
        found = []
        for way_m in (20.0, 24.0):
            T = world.track.pose(way_m) @ upright(0.0, 0.0, world.sensor_height_m, 0.1)
            T = T @ T_BODY_OPTICAL if model.is_optical else T
            found.append(RayCaster(world).cast(T, model, np.random.default_rng(1), 0.0).scan())
        assert choose_preset(found).preset == wanted


class TestWhatCounts:
    def test_the_nearer_of_two_reaches(self) -> None:
        near, far = around(20.0), around(60.0)
        assert choose_preset([near, far]).preset == choose_preset([far, near]).preset == "lidar_indoor"
        assert choose_preset([far, far]).preset == "lidar_outdoor"

    def test_the_median_of_many(self) -> None:
        assert choose_preset([around(20.0), *[around(60.0, k) for k in range(4)]]).preset == "lidar_outdoor"

    @pytest.mark.parametrize(("half_angle_deg", "wanted"), [(35.0, "rgbd_indoor"), (90.0, "lidar_indoor")])
    def test_a_camera_is_near_and_looks_one_way(self, half_angle_deg: float, wanted: str) -> None:
        assert choose_preset([around(8.0, half_angle_deg=half_angle_deg)]).preset == wanted
        assert choose_preset([around(2.0 * CAMERA_REACH_M, half_angle_deg=35.0)]).preset == "lidar_indoor"

    def test_neither_the_carrier_nor_marks_of_no_return(self) -> None:
        scan = around(60.0)
        own = np.random.default_rng(1).uniform(-0.15, 0.15, (4000, 3))
        crowded = Scan(np.vstack([scan.points, own, np.zeros((9000, 3))]))
        assert choose_preset([crowded]) == choose_preset([scan])

    def test_not_the_frame(self) -> None:
        scan, away = around(20.0), np.array([300.0, -80.0, 5.0])
        moved = Scan(scan.points + away, sensor_origin=away)
        assert choose_preset([moved]).outlook.reach_m == pytest.approx(look_out(scan.points, np.zeros(3)).reach_m)

    def test_no_point_says_nothing(self) -> None:
        empty = Scan(np.zeros((0, 3)))
        assert choose_preset([empty, around(20.0)]).preset == "lidar_indoor"
        nothing = choose_preset([empty])
        assert (nothing.preset, nothing.outlook, nothing.may_be) == ("lidar_outdoor", None, "")

    def test_the_choice_is_a_preset_as_it_is_and_says_why(self) -> None:
        choice = choose_preset([around(20.0)])
        assert choice.config == preset("lidar_indoor")
        told = choice.summary()
        assert (told["preset"], told["voxel_size_m"], told["max_range_m"]) == ("lidar_indoor", 0.3, 60.0)
        assert f"{told['reach_m']:.1f} m (below {INDOOR_REACH_M:g} m)" in told["why"]
        assert json.loads(json.dumps(dict(told))) == told


# --- commands ------------------------------------------------------------------------------------------------------


def test_auto_needs_scans() -> None:
    with pytest.raises(ConfigError, match=r"chosen from scans.*lidar_indoor"):
        preset(AUTO)
    assert_refused(run("config", AUTO), "auto is chosen from scans", "lidar_indoor")


def test_register_and_verify_choose_by_default_and_say_so(scans, tmp_path) -> None:  # noqa: F811
    found = tmp_path / "found.json"
    registered = run("register", scans[1], scans[0], "--json", found)
    result = json.loads(found.read_text())
    assert (result["verdict"], result["preset"], result["chosen"]["preset"]) == ("accepted", "auto", "lidar_indoor")
    assert f"preset auto: lidar_indoor, {result['chosen']['why']}" in registered.stdout
    verified = run("verify", scans[1], scans[0], "--transform", found, "--json", "-")
    assert json.loads(verified.stdout)["chosen"] == result["chosen"]
    viewed = run("view", scans[1], scans[0], "--result", found, "--out", tmp_path / "view.html")
    assert viewed.exit_code == 0, viewed.output


def test_it_decides_as_the_preset_that_it_chose(scans) -> None:  # noqa: F811
    by_auto, by_name = (
        json.loads(run("register", scans[1], scans[0], "--preset", name, "--json", "-").stdout)
        for name in ("auto", "lidar_indoor")
    )
    assert by_auto["best_candidate"] == by_name["best_candidate"]
    assert "chosen" not in by_name


def test_values_of_file_and_command_line_win(scans, tmp_path) -> None:  # noqa: F811
    (tmp_path / "c.yaml").write_text("preset: auto\npreprocess.min_points: 1000000\nmethod: sc2\n")
    arguments = ("register", scans[1], scans[0], "--config", tmp_path / "c.yaml", "--json", "-")
    assert_refused(run(*arguments), "at least 1000000 points", "60 m")  # the choice's range, the file's number
    (tmp_path / "c.yaml").write_text("preset: auto\nmethod: sc2\n")
    by_file, by_option = (json.loads(run(*arguments, *more).stdout) for more in ((), ("--method", "svc")))
    assert (by_file["preset"], by_file["chosen"]["preset"], by_file["method"]) == ("auto", "lidar_indoor", "sc2")
    assert by_option["method"] == "svc"
    assert json.loads(run(*arguments, "--preset", "lidar_outdoor").stdout)["preset"] == "lidar_outdoor"


def test_values_that_fit_no_preset_are_refused_before_scans_are_read(tmp_path) -> None:
    (tmp_path / "bad.yaml").write_text("preset: auto\npreprocess.voxel_size_m: 99.0\n")
    gone = tmp_path / "gone.bin"
    assert_refused(run("register", gone, gone, "--config", tmp_path / "bad.yaml"), "bad.yaml", "voxel_size_m")


def test_a_scan_without_enough_points_is_named(scans, tmp_path) -> None:  # noqa: F811
    np.zeros((40, 4), np.float32).tofile(tmp_path / "few.bin")
    assert_refused(run("register", scans[0], tmp_path / "few.bin"), "few.bin")


def test_a_data_set_keeps_its_own_unless_told(tmp_path) -> None:
    folder = mini_data.write_dataset(tmp_path / "room")
    own, told = (
        json.loads(run("evaluate", folder, "--limit", 1, *more, "--json", "-").stdout)
        for more in ((), ("--preset", "auto"))
    )
    assert (own["preset"], "chosen" in own) == ("lidar_indoor", False)
    assert (told["preset"], told["chosen"]["preset"]) == ("auto", "lidar_indoor")
    assert told["registration"]["num_correct_accepted"] == own["registration"]["num_correct_accepted"] == 1
    text = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps(text | {"preset": "auto"}))
    assert json.loads(run("evaluate", folder, "--limit", 1, "--json", "-").stdout)["chosen"] == told["chosen"]


@pytest.mark.parametrize("mode", ["pair", "scan_matching"])
def test_replay_chooses_by_the_first_clouds(bag, tmp_path, mode) -> None:  # noqa: F811
    if mode == "scan_matching":
        pytest.importorskip("kiss_icp", reason="needs kiss-icp")
    (tmp_path / "c.yaml").write_text("matching.max_correspondences: 4321\n")
    arguments = ("replay", bag, "--config", tmp_path / "c.yaml", "--mode", mode, "--out", tmp_path / "out")
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    assert "preset auto: lidar_indoor, 98 % of the points" in " ".join(done.stdout.split())
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["preset"], summary["chosen"]["preset"]) == ("auto", "lidar_indoor")
    found = read_config_file(tmp_path / "out" / "config.yaml")
    wanted = with_values(preset("lidar_indoor"), {"matching.max_correspondences": 4321})
    assert (found.preset, found.applied_to(preset("rgbd_indoor"))) == ("lidar_indoor", wanted)
    assert "lidar_indoor" in (tmp_path / "out" / "report.html").read_text("utf-8")
    again = run(*arguments, "--resume")  # it chooses the same, so that the run may go on
    assert again.exit_code == 0, again.output


def test_several_bags_choose_each_for_itself(bag, tmp_path) -> None:  # noqa: F811
    from svc_ros.io.bags import CloudBagWriter

    with CloudBagWriter(tmp_path / "far") as writer:
        for k in range(2):
            writer.write_points(1_700_000_000_000_000_000 + k * 10**9, "lidar", around(70.0).points, "/points")
    done = run("replay", bag, tmp_path / "far", "--no-report", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    runs = json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]
    assert [run["chosen"]["preset"] for run in runs] == ["lidar_indoor", "lidar_outdoor"]


def test_doctor_and_the_choice_are_one(bag) -> None:  # noqa: F811
    findings = json.loads(run("doctor", bag, "--no-trial", "--json", "-").stdout)["findings"]
    (told,) = (f["found"] for f in findings if f["name"] == "/points preset")
    with Bag(bag) as recorded:
        choice = choose_preset(first_scans(recorded, BagPart("/points"), 3))
    assert told == f"{choice.preset}: {choice.why}"


def test_calibrate_writes_the_preset_that_was_chosen(tmp_path) -> None:
    folder, out = mini_data.write_dataset(tmp_path / "room"), tmp_path / "out"
    options = ("--preset", "auto", "--max-wrong-rate", 0.8, "--no-page", "--out", out, "--json", "-")
    done = run("calibrate", folder, *options)
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    assert (summary["preset"], summary["chosen_preset"]["preset"]) == ("auto", "lidar_indoor")
    assert read_config_file(out / "calibration.yaml").preset == "lidar_indoor"


def test_calibrate_refuses_data_of_two_kinds(tmp_path) -> None:
    near, far = (mini_data.write_dataset(tmp_path / name) for name in ("near", "far"))
    for path in (far / "scans").glob("*.bin"):
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        (points * np.float32([12.0, 12.0, 12.0, 1.0])).tofile(path)
    refused = run("calibrate", near, far, "--preset", "auto")
    assert_refused(refused, "data of one preset", "lidar_indoor", "lidar_outdoor")


def test_a_copy_of_a_scan_in_another_place_of_memory_chooses_the_same(scans) -> None:  # noqa: F811
    from svc_ros.io.clouds.files import read_scan

    scan = read_scan(scans[0])
    shuffled = replace(scan, points=scan.points[np.random.default_rng(0).permutation(len(scan))])
    one, other = choose_preset([scan]), choose_preset([shuffled])
    assert (one.preset, one.outlook.reach_m) == (other.preset, other.outlook.reach_m)
