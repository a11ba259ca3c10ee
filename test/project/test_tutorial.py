"""The commands of docs/tutorial.md are run in their order, in a folder of their own, and print what the page shows."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from places import PROJECT_ROOT
from yardstick import PATIENCE_S

PAGE = (PROJECT_ROOT / "docs" / "tutorial.md").read_text("utf-8")
BLOCK = re.compile(r"^```(sh|text)( terminal \d)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LIVE = PAGE.index("## 6.")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
PROGRAMS = {
    "registration_node": "-m svc_ros.ros.node", "bag_player": "-m svc_ros.ros.bag_player", "svc_ros": "-m svc_ros",
}  # fmt: skip
SLACK, LEAST = 0.3, 0.05  # numbers may differ by that share, or by so little
TIMES = re.compile(r"times real time|warm-up|times as fast")


@dataclass(frozen=True)
class Step:
    """A block of commands, its terminal (empty: any), and what the page shows of its output."""

    commands: str
    terminal: str
    shown: str


def steps_of(text: str) -> list[Step]:
    found: list[Step] = []
    for kind, terminal, body in BLOCK.findall(text):
        if kind == "sh":
            found.append(Step(body, terminal.strip(), ""))
        else:
            found[-1] = Step(found[-1].commands, found[-1].terminal, body)
    return found


def differences(shown: str, printed: str) -> list[str]:
    """Lines of the page that the output does not have, in their order; `...` stands for any lines."""
    lines, missing = [tidy(line) for line in printed.splitlines()], []
    for line in (tidy(line) for line in shown.splitlines() if line.strip() != "..."):
        place = next((k for k, other in enumerate(lines) if alike(line, other)), None)
        if place is None:
            missing.append(line)
        else:
            lines = lines[place + 1 :]
    return missing


def tidy(line: str) -> str:
    return re.sub(r"\s+", " ", line).strip()


def alike(line: str, other: str) -> bool:
    """Equal but for numbers, which are near each other; times are as they are."""
    if NUMBER.sub("#", line) != NUMBER.sub("#", other):
        return False
    pairs = zip(map(float, NUMBER.findall(line)), map(float, NUMBER.findall(other)), strict=True)
    return bool(TIMES.search(line)) or all(abs(a - b) <= max(SLACK * abs(a), LEAST) for a, b in pairs)


@pytest.fixture(scope="module")
def terminal(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the programs are those of this checkout, and `out` is a new folder."""
    folder = tmp_path_factory.mktemp("tutorial")
    (folder / "bin").mkdir()
    for name, words in {**PROGRAMS, "python": ""}.items():
        (folder / "bin" / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        (folder / "bin" / name).chmod(0o755)
    path = os.pathsep.join((str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]))
    python_path = os.pathsep.join(filter(None, (str(PROJECT_ROOT), os.environ.get("PYTHONPATH", ""))))
    return {**os.environ, "PATH": path, "PYTHONPATH": python_path, "PWD": str(folder), "COLUMNS": "80"}


def run(step: Step, terminal: dict[str, str]) -> str:
    done = subprocess.run(
        ["bash", "-e", "-c", step.commands], cwd=terminal["PWD"], env=terminal, capture_output=True, text=True,
        timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{step.commands}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def printed(terminal: dict[str, str]) -> dict[str, str]:
    """Output of every block before the live part, by its commands."""
    return {step.commands: run(step, terminal) for step in steps_of(PAGE[:LIVE])}


@pytest.mark.slow
def test_the_commands_print_what_the_page_shows(printed: dict[str, str]) -> None:
    steps = steps_of(PAGE[:LIVE])
    assert len(steps) == 9
    missing = {step.commands: differences(step.shown, printed[step.commands]) for step in steps}
    assert {commands: lines for commands, lines in missing.items() if lines} == {}


@pytest.mark.slow
def test_the_pages_that_are_to_be_opened_are_there(printed: dict[str, str], terminal: dict[str, str]) -> None:
    pages = re.findall(r"[Oo]pen `([^`]+)`", PAGE)
    assert len(pages) == 2
    for page in pages:
        assert (Path(terminal["PWD"]) / page).read_text("utf-8").lstrip().lower().startswith("<!doctype html")


@pytest.fixture
def node(terminal: dict[str, str], printed: dict[str, str]) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """The program of terminal 1, with what it logs; it has a domain of its own."""
    processes = pytest.importorskip("svc_ros.ros.processes", reason="needs rclpy (pip install svc_ros[ros])")
    terminal.update(ROS_DOMAIN_ID=str(processes.own_domain_id(11)), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    (step,) = [step for step in steps_of(PAGE[LIVE:]) if step.terminal == "terminal 1"]
    log = Path(terminal["PWD"]) / "node.log"
    command = ["bash", "-c", f"exec {step.commands}"]
    with log.open("wb") as file:
        process = subprocess.Popen(command, cwd=terminal["PWD"], env=terminal, stdout=file, stderr=file)
        yield process, log
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.dds
def test_the_live_part(node: tuple[subprocess.Popen[bytes], Path], terminal: dict[str, str]) -> None:
    process, log = node
    first, player, graphs = steps_of(PAGE[LIVE:])
    assert differences(player.shown, run(player, terminal)) == []
    time.sleep(5.0)  # some seconds later
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) in (0, 130, -signal.SIGINT)
    assert differences(first.shown, log.read_text("utf-8")) == []
    assert differences(graphs.shown, run(graphs, terminal)) == []


def test_differences_are_found() -> None:
    printed = "ACCEPTED  ok  overlap 0.737\n  0.9998   2.99\ntotal 12 ms\n3.0 times real time"
    assert differences("ACCEPTED ok overlap 0.70\n...\n9 times real time", printed) == []
    assert differences("REJECTED ok overlap 0.737", printed) == ["REJECTED ok overlap 0.737"]
    assert differences("ACCEPTED ok overlap 0.2", printed) == ["ACCEPTED ok overlap 0.2"]
    assert differences("total 12 ms\nACCEPTED ok overlap 0.737", printed) == ["ACCEPTED ok overlap 0.737"]


def test_every_block_with_a_command_is_run_or_is_for_the_reader() -> None:
    others = re.findall(r"^```\n(.*?)^```$", BLOCK.sub("", PAGE), re.MULTILINE | re.DOTALL)
    assert [text.splitlines()[0] for text in others] == [". .venv/bin/activate", "svc_ros doctor BAG"]
