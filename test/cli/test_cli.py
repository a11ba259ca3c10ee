"""The command line: what it prints where, its exit codes, and one line for every kind of bad input."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import mini_data
import numpy as np
import pytest
from command_line import assert_refused, run
from places import PROJECT_ROOT
from replay_cases import OPTIMIZED
from yardstick import PATIENCE_S, Stopwatch

import svc_ros
from svc_ros.cli.doctor.finding import Finding
from svc_ros.core.config import PRESETS
from svc_ros.core.se3 import make_pose, pose_error
from svc_ros.io.bags import CloudBagWriter
from svc_ros.io.results import read_jsonl

START_NS = 1_700_000_000_000_000_000
PRESET = ("--preset", "lidar_indoor")


@pytest.fixture(scope="module")
def scans(tmp_path_factory) -> list[Path]:
    return mini_data.write_scans(tmp_path_factory.mktemp("scans"))


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "room", (0, 1, 2))


def write_bag(path: Path, order: tuple[int, ...], topic: str = "/points") -> Path:
    with CloudBagWriter(path) as writer:
        for k, place in enumerate(order):
            points = mini_data.scan_room(mini_data.POSES[place], seed=k)
            writer.write_points(START_NS + k * 10**9, "lidar", points, topic)
    return path


# --- the program ---------------------------------------------------------------------------------------------------


def test_help_answers_at_once_in_a_process_of_its_own():
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "svc_ros", "--help"], cwd=PROJECT_ROOT, capture_output=True, text=True, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 3.0
    for command in ("register", "verify", "evaluate", "calibrate", "replay", "simulate", "config", "doctor"):
        assert command in done.stdout


def test_help_imports_nothing_heavy():
    code = (
        "import sys, svc_ros.cli.main\n"
        "heavy = {'open3d', 'numba', 'scipy', 'rosbags', 'matplotlib', 'rclpy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], cwd=PROJECT_ROOT, check=True)


def test_version():
    result = run("--version")
    assert (result.exit_code, result.stdout) == (0, f"svc_ros {svc_ros.__version__}\n")


def test_no_command_shows_the_help_and_is_an_error():
    result = run()
    assert result.exit_code == 2
    assert "register" in result.stdout
    assert result.stderr.startswith("error: expected a command")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["regster"], ["regster", "'register'"]),
        (["register"], ["SOURCE"]),
        (["register", "a", "b", "--colour"], ["--colour"]),
        (["evaluate", "a", "--limit", "many"], ["--limit"]),
        (["evaluate", "a", "--workers", "0"], ["--workers"]),
        (["verify", "a", "b"], ["--transform"]),
        (["replay", "a"], ["--out"]),
    ],
)
def test_bad_usage_is_one_line(arguments, words):
    assert_refused(run(*arguments), *words)


# --- register and verify -------------------------------------------------------------------------------------------


def test_register_prints_one_object_and_nothing_else(scans):
    done = subprocess.run(
        [sys.executable, "-m", "svc_ros", "register", str(scans[1]), str(scans[0]), *PRESET, "--json", "-"],
        cwd=PROJECT_ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    result = json.loads(done.stdout)
    assert (result["verdict"], result["reason"], result["preset"]) == ("accepted", "ok", "lidar_indoor")
    assert {"covariance", "evidence", "counts", "best_candidate", "source", "target"} <= set(result)
    assert {"prepare", "features", "matching", "total"} <= set(result["time_ms"])
    angle, distance = pose_error(result["T_target_source"], mini_data.pose_between(1, 0))
    assert angle < 1.0
    assert distance < 0.1
    assert "ACCEPTED" in done.stderr


def test_register_without_json_is_readable(scans):
    result = run("register", scans[1], scans[0], *PRESET)
    assert result.exit_code == 0
    assert "ACCEPTED" in result.stdout
    assert "oriented_overlap_ratio" in result.stdout
    assert "time [ms]" in result.stdout


def test_a_result_file_of_register_can_be_verified(scans, tmp_path):
    found = tmp_path / "found.json"
    assert run("register", scans[1], scans[0], *PRESET, "--json", found).exit_code == 0
    result = run("verify", scans[1], scans[0], "--transform", found, *PRESET, "--json", "-", "--fail-on-reject")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["verdict"] == "accepted"


def test_a_wrong_pose_is_done_with_0_or_with_3_on_request(scans, tmp_path):
    wrong = mini_data.pose_between(1, 0)
    wrong[:3, 3] += (3.0, -2.0, 0.0)
    np.savetxt(tmp_path / "wrong.txt", wrong[:3].reshape(1, 12))
    arguments = ("verify", scans[1], scans[0], "--transform", tmp_path / "wrong.txt", *PRESET, "--json", "-")
    result = run(*arguments)
    assert result.exit_code == 0
    assert json.loads(result.stdout)["verdict"] != "accepted"
    assert json.loads(result.stdout)["T_target_source"] is None
    assert run(*arguments, "--fail-on-reject").exit_code == 3


def test_the_same_scan_twice_is_the_identity(scans):
    result = run("register", scans[0], scans[0], *PRESET, "--json", "-")
    angle, distance = pose_error(json.loads(result.stdout)["T_target_source"], np.eye(4))
    assert angle < 0.5
    assert distance < 0.05


# --- preset, YAML, command line ------------------------------------------------------------------------------------


def test_the_command_line_wins_over_the_file_and_the_file_over_the_preset(scans, tmp_path):
    config = tmp_path / "config.yaml"
    config.write_text("preset: lidar_indoor\nmethod: sc2\n")
    arguments = ("register", scans[1], scans[0], "--config", config, "--json", "-")
    by_file = json.loads(run(*arguments).stdout)
    assert (by_file["preset"], by_file["method"]) == ("lidar_indoor", "sc2")
    by_option = json.loads(run(*arguments, "--method", "svc", "--preset", "lidar_outdoor").stdout)
    assert (by_option["preset"], by_option["method"]) == ("lidar_outdoor", "svc")


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_printed_preset_can_be_read_back(name, tmp_path):
    printed = run("config", name)
    assert printed.exit_code == 0
    (tmp_path / "printed.yaml").write_text(printed.stdout)
    again = run("config", "--config", tmp_path / "printed.yaml")
    assert again.stdout == printed.stdout
    assert run("config", name, "--out", tmp_path / "written.yaml").stdout == ""
    assert (tmp_path / "written.yaml").read_text() == printed.stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--preset", "lidar_outdor"], ["lidar_outdor", "did you mean 'lidar_outdoor'"]),
        (["--method", "svc_papr"], ["svc_papr", "did you mean 'svc_paper'"]),
        (["--config", "gone.yaml"], ["gone.yaml"]),
    ],
)
def test_unknown_names_come_with_the_nearest(scans, options, words):
    assert_refused(run("register", scans[1], scans[0], *options), *words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("preprocess:\n  voxel_size: 0.2\n", ["voxel_size", "did you mean 'preprocess.voxel_size_m'"]),
        ("preset: lidar_indor\n", ["lidar_indor", "did you mean 'lidar_indoor'"]),
        ("preprocess:\n  voxel_size_m: coarse\n", ["voxel_size_m", "expected float"]),
        ("preprocess: [\n", ["not valid YAML"]),
    ],
)
def test_a_bad_configuration_names_file_and_key(scans, tmp_path, content, words):
    (tmp_path / "bad.yaml").write_text(content)
    assert_refused(run("register", scans[1], scans[0], "--config", tmp_path / "bad.yaml"), "bad.yaml", *words)


# --- bad scans -----------------------------------------------------------------------------------------------------


def pcd(points: int, data: str, fields: str = "x y z") -> str:
    n = len(fields.split())
    return (
        f"VERSION 0.7\nFIELDS {fields}\nSIZE {'4 ' * n}\nTYPE {'F ' * n}\nCOUNT {'1 ' * n}\n"
        f"WIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA ascii\n{data}"
    )


def ply(points: int, data: str) -> str:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return f"ply\nformat ascii 1.0\nelement vertex {points}\n{axes}end_header\n{data}"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.bin", "", []),
        ("empty.pcd", pcd(0, ""), []),
        ("few.pcd", pcd(2, "1 2 3\n4 5 6\n"), ["points"]),
        ("fields.pcd", pcd(2, "1 2\n4 5\n", "u v"), ["x"]),
        ("cut.pcd", pcd(1000, "1 2 3\n4 5 6\n"), []),
        ("cut.ply", ply(1000, "1 2 3\n"), []),
        ("header.ply", "ply\nformat ascii 1.0\nelement vertex", []),
        ("nan.pcd", pcd(3, "nan nan nan\n" * 3), []),
        ("size.bin", "123456789", []),
        ("text.npy", "no array", []),
        ("scan.docx", "1 2 3", []),
    ],
)
def test_a_bad_scan_is_refused_with_its_name(scans, tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    assert_refused(run("register", tmp_path / name, scans[0], *PRESET), name, *words)
    np.savetxt(tmp_path / "identity.txt", np.eye(4))
    verified = run("verify", scans[0], tmp_path / name, "--transform", tmp_path / "identity.txt", *PRESET)
    assert_refused(verified, name, *words)


def test_missing_files_and_folders_are_refused(scans, tmp_path):
    assert_refused(run("register", scans[0], tmp_path / "gone.pcd"), "gone.pcd")
    assert_refused(run("register", tmp_path, scans[0]), str(tmp_path))
    assert_refused(run("verify", scans[1], scans[0], "--transform", tmp_path / "gone.txt"), "gone.txt")


def test_fewer_points_than_needed_says_how_many_and_in_which_file(scans, tmp_path):
    few = mini_data.write_bin(tmp_path / "few.bin", mini_data.scan_room(mini_data.POSES[0])[:40])
    assert_refused(run("register", scans[0], few, *PRESET), "few.bin", "100")


@pytest.mark.parametrize("content", ["1 2 3", "not a pose", "2 0 0 0 0 2 0 0 0 0 2 0"])
def test_what_is_no_pose_is_refused(scans, tmp_path, content):
    (tmp_path / "pose.txt").write_text(content)
    assert_refused(run("verify", scans[1], scans[0], "--transform", tmp_path / "pose.txt", *PRESET), "pose.txt")


@pytest.mark.parametrize("place", ["gone/result.json", "."])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(scans, tmp_path, place):
    with Stopwatch() as watch:
        assert_refused(run("register", scans[1], scans[0], "--json", tmp_path / place), "--json", str(tmp_path))
    assert watch.own_s < 1.0, watch


# --- evaluate ------------------------------------------------------------------------------------------------------


def test_evaluate_writes_the_report_and_shows_it(tmp_path):
    folder = mini_data.write_dataset(tmp_path / "room")
    result = run("evaluate", folder, "--limit", 1, "--json", tmp_path / "report.json")
    assert result.exit_code == 0
    assert "success_rate" in result.stdout
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["preset"] == "lidar_indoor"  # the data set's own
    assert report["registration"]["num_correct_accepted"] == 1
    alone = run("evaluate", folder, "--limit", 1, "--method", "sc2", "--preset", "lidar_outdoor", "--json", "-")
    report = json.loads(alone.stdout)
    assert (report["preset"], report["method"]) == ("lidar_outdoor", "sc2")
    assert "success_rate" in alone.stderr


def test_evaluate_refuses_what_is_no_data_set(tmp_path):
    assert_refused(run("evaluate", tmp_path / "gone"), "gone")
    assert_refused(run("evaluate", tmp_path), "dataset.json")
    folder = mini_data.write_dataset(tmp_path / "room")
    (folder / "scans" / "1.bin").unlink()
    assert_refused(run("evaluate", folder), "pair scans/1.bin -> scans/0.bin", "1.bin")


# --- replay --------------------------------------------------------------------------------------------------------


def write_reference(path: Path, T_reference_lidar: np.ndarray) -> Path:
    from scipy.spatial.transform import Rotation

    lines = []
    for k in range(3):
        T = mini_data.POSES[k] @ np.linalg.inv(T_reference_lidar)
        numbers = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
        lines.append(f"{START_NS // 10**9 + k}.0 " + " ".join(f"{v:.9f}" for v in numbers))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_replay_leaves_decisions_results_and_configuration(bag, tmp_path):
    out = tmp_path / "new" / "walk"
    reference = write_reference(tmp_path / "reference.txt", np.eye(4))
    result = run("replay", bag, *PRESET, "--out", out, "--reference", reference)
    assert result.exit_code == 0, result.output
    assert "accepted" in result.stdout
    rows = read_jsonl(out / "decisions.jsonl")
    assert [(r["source_index"], r["target_index"]) for r in rows] == [(1, 0), (2, 1)]
    assert [r["source_stamp_ns"] - r["target_stamp_ns"] for r in rows] == [10**9, 10**9]
    assert all(r["verdict"] == "accepted" and r["translation_error_m"] < 0.1 for r in rows)
    assert (out / "config.yaml").read_text() == run("config", "lidar_indoor").stdout
    assert mcap_counts(out / "results.mcap")["/svc_registration/decision"] == 2


def mcap_counts(path: Path) -> dict[str, int]:
    from svc_ros.io.bags import Bag

    with Bag(path) as recorded:
        return {topic.name: topic.count for topic in recorded.topics}


def test_a_reference_of_another_frame_goes_through_the_bags_transforms(tmp_path):
    mounting = make_pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (0.5, 0.0, 1.0))
    with CloudBagWriter(tmp_path / "bag") as writer:
        writer.write_transform(START_NS, "base_link", "lidar", mounting, static=True)
        for k in range(3):
            writer.write_points(START_NS + k * 10**9, "lidar", mini_data.scan_room(mini_data.POSES[k], seed=k))
    reference = write_reference(tmp_path / "reference.txt", mounting)
    options = (*PRESET, "--out", tmp_path / "out", "--reference", reference)
    assert run("replay", tmp_path / "bag", *options, "--reference-frame", "base_link").exit_code == 0
    assert max(r["translation_error_m"] for r in read_jsonl(tmp_path / "out" / "decisions.jsonl")) < 0.1
    assert run("replay", tmp_path / "bag", *options).exit_code == 0  # taken as the lidar's own poses: wrong
    assert max(r["translation_error_m"] for r in read_jsonl(tmp_path / "out" / "decisions.jsonl")) > 0.3
    assert_refused(run("replay", tmp_path / "bag", *options, "--reference-frame", "mast"), "mast", "base_link")


def test_a_scan_outside_the_reference_has_no_errors(bag, tmp_path):
    (tmp_path / "elsewhere.txt").write_text("10.0 0 0 0 0 0 0 1\n11.0 0 0 0 0 0 0 1\n")
    result = run("replay", bag, *PRESET, "--out", tmp_path, "--reference", tmp_path / "elsewhere.txt")
    assert result.exit_code == 0
    assert [r["rotation_error_deg"] for r in read_jsonl(tmp_path / "decisions.jsonl")] == [None, None]


@pytest.mark.parametrize("mode", ["scan_matching", "loop_closure"])
def test_replay_of_a_stream_leaves_trajectory_graph_and_report(bag, tmp_path, mode):
    reference = write_reference(tmp_path / "reference.txt", np.eye(4))
    result = run("replay", bag, *PRESET, "--mode", mode, "--out", tmp_path / "out", "--reference", reference)
    assert result.exit_code == 0, result.output
    found = {path.name for path in (tmp_path / "out").iterdir()}
    assert found == {"decisions.jsonl", "trajectory_tum.txt", "loops.g2o", "results.mcap", "config.yaml",
                     "summary.json", "report.html",
                     *(OPTIMIZED if mode == "loop_closure" else ())}  # fmt: skip
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["mode"], summary["num_scans"]) == (mode, 3)
    last = result.stdout.splitlines()[-1]
    assert last.startswith(f"{summary['num_decisions']} decisions on 3 scans")
    assert ("false loops: 0" if mode == "loop_closure" else "false accepts: 0") in last
    assert "times real time" in last
    assert result.stderr == ""


def test_several_bags_leave_a_folder_each(bag, tmp_path):
    write_bag(tmp_path / "bags" / "b", (0, 1))
    write_bag(tmp_path / "bags" / "a", (1, 0, 1))
    (tmp_path / "bags" / "notes.txt").write_text("not a bag")
    out = tmp_path / "out"
    result = run("replay", tmp_path / "bags" / "*", bag, *PRESET, "--no-report", "--out", out)
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in out.iterdir()) == ["a", "b", "room", "summary.json"]
    assert [len(read_jsonl(out / name / "decisions.jsonl")) for name in ("a", "b", "room")] == [2, 1, 2]
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["num_bags"], summary["num_decisions"], summary["interrupted"]) == (3, 5, False)
    assert [run["out"] for run in summary["runs"]] == ["a", "b", "room"]
    assert "5 decisions on 8 scans" in result.stdout


def test_a_bag_that_cannot_be_read_does_not_keep_the_others(bag, tmp_path):
    (tmp_path / "cut.mcap").write_bytes(next(bag.glob("*.mcap")).read_bytes()[:5000])
    result = run("replay", tmp_path / "cut.mcap", bag, *PRESET, "--no-report", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: 1 of 2 bags could not be replayed: ")
    assert "cut.mcap" in result.stderr
    assert len(read_jsonl(tmp_path / "out" / "room" / "decisions.jsonl")) == 2
    runs = json.loads((tmp_path / "out" / "summary.json").read_text())["runs"]
    assert [run["state"] for run in runs] == ["failed", "complete"]


def test_parts_and_strides_of_a_bag(bag, tmp_path):
    options = (*PRESET, "--no-report", "--out")
    assert run("replay", bag, "--start", 1, *options, tmp_path / "late").exit_code == 0
    assert [r["target_stamp_ns"] for r in read_jsonl(tmp_path / "late" / "decisions.jsonl")] == [START_NS + 10**9]
    assert run("replay", bag, "--duration", 1.5, *options, tmp_path / "early").exit_code == 0
    assert [r["target_stamp_ns"] for r in read_jsonl(tmp_path / "early" / "decisions.jsonl")] == [START_NS]
    assert run("replay", bag, "--stride", 2, *options, tmp_path / "wide").exit_code == 0
    assert [r["source_index"] for r in read_jsonl(tmp_path / "wide" / "decisions.jsonl")] == [2]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--start", -1], ["--start"]),
        (["--start", 99], ["2.0 s", "99 s"]),
        (["--duration", 0], ["duration above 0 s"]),
        (["--max-rate", 0], ["rate above 0 Hz"]),
        (["--odometry-frame", "odom"], ["--odometry-frame odom", "loop_closure"]),
        (["--mode", "loop_closure", "--odometry-frame", "odom"], ["--odometry-frame odom", "none"]),
        (["--reference-frame", "base"], ["--reference-frame base", "--reference"]),
        (["--mode", "localization"], ["--map"]),
        (["--map", "map"], ["--map", "localization"]),
        (["--mode", "localization", "--map", "map"], ["map", "config.yaml"]),
        (["--mode", "localization", "--map", "map", *PRESET], ["--preset lidar_indoor", "its own configuration"]),
    ],
)
def test_replay_refuses_what_makes_no_sense(bag, tmp_path, options, words):
    assert_refused(run("replay", bag, *options, "--out", tmp_path / "out"), *words)
    assert not (tmp_path / "out").exists()


def test_replay_refuses_what_it_cannot_read_or_write(bag, tmp_path):
    (tmp_path / "file").write_text("in the way")
    out = ("--out", tmp_path / "out")
    assert_refused(run("replay", tmp_path / "gone.bag", *out), "gone.bag")
    assert_refused(run("replay", bag, "--topic", "/lidar", *out), "/lidar", "/points")
    assert_refused(run("replay", bag, "--mode", "pairs", *out), "did you mean 'pair'")
    assert_refused(run("replay", bag, "--out", tmp_path / "file"), "--out", "file")
    assert_refused(run("replay", bag, "--out", tmp_path / "file" / "below"), "--out", "file")
    assert_refused(run("replay", bag, "--reference", tmp_path / "gone.txt", *out), "gone.txt")
    whole = next(bag.glob("*.mcap")).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    assert_refused(run("replay", tmp_path / "cut.mcap", "--strict", *out), "cut.mcap")


def test_two_cloud_topics_need_a_name(tmp_path):
    with CloudBagWriter(tmp_path / "two") as writer:
        for topic in ("/front", "/rear"):
            writer.write_points(START_NS, "lidar", np.ones((10, 3)), topic)
    assert_refused(run("replay", tmp_path / "two", "--out", tmp_path / "out"), "/front", "/rear")


def test_ctrl_c_leaves_complete_outputs_that_can_be_continued(tmp_path):
    bag = write_bag(tmp_path / "long", (0, 1, 2, 1) * 12)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "svc_ros", "replay", str(bag), *PRESET, "--no-report", "--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT_ROOT)}
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        wait_for_lines(out / "decisions.jsonl", 2, process)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    rows = read_jsonl(out / "decisions.jsonl")
    assert 2 <= len(rows) < 47
    assert mcap_counts(out / "results.mcap")["/svc_registration/decision"] == len(rows)
    assert json.loads((out / "summary.json").read_text())["state"] == "interrupted"
    assert_refused(run("replay", bag, *PRESET, "--stride", 2, "--resume", "--out", out), "--resume", "stride")
    result = run("replay", bag, *PRESET, "--no-report", "--resume", "--out", out)
    assert result.exit_code == 0, result.output
    continued = read_jsonl(out / "decisions.jsonl")
    assert [row["source_index"] for row in continued] == list(range(1, 48))
    assert continued[: len(rows)] == rows
    assert mcap_counts(out / "results.mcap")["/svc_registration/decision"] == 47


def wait_for_lines(path: Path, count: int, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and process.poll() is None:
        if path.exists() and path.read_text().count("\n") >= count:
            return
        time.sleep(0.05)
    pytest.fail(f"no {count} decisions in {path}")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_truncated_ros1_bag_is_refused_where_damage_is(shared_data, tmp_path, share):
    whole = (shared_data / "bags" / "os0_64_walk" / "ros1_first22.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(whole[: int(share * len(whole))])
    assert_refused(run("replay", tmp_path / "cut.bag", "--strict", "--out", tmp_path / "out"), "cut.bag")


# --- doctor --------------------------------------------------------------------------------------------------------


def test_doctor_looks_at_a_bag(bag):
    result = run("doctor", bag, "--json", "-")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert report["num_errors"] == 0
    assert any(f["name"] == "topic /points" for f in report["findings"])
    assert "/points" in result.stderr


def test_doctor_tries_a_preset_unless_told_not_to(bag):
    tried = run("doctor", bag, "--json", "-")
    names = [f["name"] for f in json.loads(tried.stdout)["findings"]]
    assert any(name.startswith("/points registration, ") for name in names)
    quick = run("doctor", bag, "--no-trial", "--json", "-")
    assert not [f for f in json.loads(quick.stdout)["findings"] if "registration" in f["name"]]


def test_doctor_fails_for_a_bag_that_cannot_be_used(tmp_path):
    with CloudBagWriter(tmp_path / "bag") as writer:
        for k in range(2):
            points = 1000.0 * mini_data.scan_room(mini_data.POSES[k], seed=k)
            writer.write_points(START_NS + k * 10**9, "lidar", points)
    result = run("doctor", tmp_path / "bag")
    assert result.exit_code == 2
    assert "millimetres" in " ".join(result.stdout.split())
    assert result.stderr.splitlines()[-1].endswith("checks failed: /points scale")


def test_doctor_fails_where_something_needed_is_missing(monkeypatch):
    findings = [Finding("numba", "error", "not installed", "pip install numba"), Finding("scipy", "ok", "1.18")]
    monkeypatch.setattr("svc_ros.cli.doctor.installation.check_installation", lambda: findings)
    result = run("doctor")
    assert result.exit_code == 2
    assert "pip install numba" in result.stdout
    assert result.stderr == "error: 1 of 2 checks failed: numba\n"
    assert_refused(run("doctor", "gone.bag"), "gone.bag")
    assert_refused(run("doctor", "--topic", "/points"), "--topic")


# --- simulate ------------------------------------------------------------------------------------------------------


def test_a_simulated_drive_can_be_replayed_against_its_reference(tmp_path):
    done = run("simulate", "--out", tmp_path / "drive", "--scene", "indoor", "--sensor", "VLP-16", "--scans", 3)
    assert done.exit_code == 0, done.output
    bag, reference = tmp_path / "drive" / "bag", tmp_path / "drive" / "reference_tum.txt"
    result = run("replay", bag, *PRESET, "--out", tmp_path / "out", "--reference", reference)
    assert result.exit_code == 0, result.output
    rows = read_jsonl(tmp_path / "out" / "decisions.jsonl")
    assert len(rows) == 2
    assert all(r["translation_error_m"] < 0.6 for r in rows if r["verdict"] == "accepted")
    again = run("simulate", "--out", tmp_path / "drive", "--scans", 1)
    assert_refused(again, "bag", "exists")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--scene", "stret"], ["did you mean 'street'"]),
        (["--sensor", "OS1-63"], ["did you mean 'OS1-64'"]),
        (["--scans", "0"], ["--scans"]),
        (["--rate", "0"], ["rate_hz > 0"]),
        (["--scans", "3", "--teleport-after", "2"], ["teleport_after"]),
    ],
)
def test_a_drive_that_cannot_be_is_refused_and_leaves_nothing(tmp_path, options, words):
    assert_refused(run("simulate", "--out", tmp_path / "drive", *options), *words)
    assert not (tmp_path / "drive").exists()


def test_the_help_of_simulate_names_every_scene_and_sensor():
    from svc_ros.cli import simulate
    from svc_ros.simulation import SCENES, SENSORS

    assert simulate._SCENES.split(", ") == list(SCENES)
    assert simulate._SENSORS.split(", ") == list(SENSORS)
