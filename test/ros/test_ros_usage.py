"""What the node's command line says for itself, without rclpy."""

from __future__ import annotations

import subprocess
import sys

import pytest
from pages import absolute, rows
from yardstick import PATIENCE_S

from svc_ros.core.config import AUTO, PRESETS
from svc_ros.ros.usage import USAGE, is_help_wanted, misplaced

RUN = "import sys; sys.modules['rclpy'] = None; from svc_ros.ros.node import main; sys.exit(main(sys.argv[1:]))"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", RUN, *words], capture_output=True, text=True, timeout=PATIENCE_S)


@pytest.mark.parametrize("word", ["-h", "--help"])
def test_help_is_printed_without_rclpy(word):
    ended = run(word)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, USAGE, "")


def test_the_usage_names_modes_presets_inputs_and_pages():
    inputs = {row[0].strip("`") for row in rows("topics") if row[1] == "in"}
    modes = {row[0].strip("`") for row in rows("modes")}
    for name in (*inputs, *modes, *PRESETS, AUTO, "--params-file", "docs/reference.md", absolute("~/decision")):
        assert name in USAGE, name
    assert max(map(len, USAGE.splitlines())) <= 120


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["mode:=pair"], "--ros-args -p mode:=pair"),
        (["-p", "mode:=pair"], "--ros-args -p ..."),
        (["points:=/lidar"], "--ros-args -r points:=/lidar"),
        (["__ns:=/robot"], "--ros-args -r __ns:=/robot"),
        (["--params-file", "mine.yaml"], "--ros-args --params-file ..."),
        (["--ros-args", "-p", "mode:=pair", "--", "preset:=auto"], "--ros-args -p preset:=auto"),
    ],
)
def test_what_ros_would_pass_over_is_refused_with_the_way_to_write_it(words, written):
    assert str(misplaced(words)).endswith(f"write: registration_node {written}")


def test_a_refused_word_is_one_line_and_exit_code_2():
    ended = run("mode:=pair")
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith("registration_node: mode:=pair stands before --ros-args")


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--ros-args", "-p", "mode:=pair", "-r", "points:=/lidar", "--params-file", "a.yaml"],
        ["anything", "--else", "--ros-args", "-r", "__node:=a", "--", "--more"],
    ],
)
def test_other_words_are_let_through(words):
    assert misplaced(words) is None
    assert not is_help_wanted(words)
