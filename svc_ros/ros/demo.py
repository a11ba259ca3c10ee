"""The whole way in one command: simulate a drive, start the node, play the drive to it, judge its answers.

Three processes over the real middleware: this one listens, a second runs the node, a third plays the bag. What is
left in the output folder: `decisions.jsonl`, `results.mcap`, `overview.png`, the drive itself and both logs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NoReturn

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console

from svc_ros.core.errors import InputError, SvcError
from svc_ros.core.scan import Array
from svc_ros.io.bags import Bag, ResultWriter
from svc_ros.io.results import write_jsonl
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.io.trajectories import read_tum
from svc_ros.report.overview import Link, draw_overview
from svc_ros.ros.collector import Answers, DecisionCollector, spin_until
from svc_ros.ros.judgement import (
    ExpectedPair,
    JudgedPair,
    decisions_table,
    expected_pairs,
    judge,
    record_of,
    verdict_on,
)
from svc_ros.ros.middleware import profile_environment
from svc_ros.ros.processes import ChildProcess, local_environment, own_domain_id
from svc_ros.simulation import DriveConfig, simulate_drive

PRESET = "lidar_outdoor"
STRIDE = 1
_MIN_SCANS = 4
_DECISIONS = "/svc_registration/decision"
_PAIR_TIMEOUT_S = 60.0
_NODE_PARAMETERS = {
    "preset": PRESET,
    "process_every": "true",
    "qos_overrides./source_points.subscription.reliability": "reliable",
    "qos_overrides./target_points.subscription.reliability": "reliable",
}


def main(args: list[str] | None = None) -> int:
    """Run the demo. Exit code 0 if every pair has its decision and no wrong pose was accepted, else 1."""
    options = _parser().parse_args(args)
    signal.signal(signal.SIGTERM, _interrupt)
    console = Console()
    try:
        problem = run(options.out, options.scans, console)
    except SvcError as error:
        problem = str(error)
    except KeyboardInterrupt:
        problem = "interrupted"
    if problem:
        console.print(f"[bold red]demo failed:[/] {problem}")
        return 1
    console.print(f"[bold green]demo passed[/]; see {options.out}")
    return 0


def run(out: Path, num_scans: int, console: Console) -> str | None:
    """Do everything; returns what is wrong with the answers, None if nothing is."""
    start = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    bag, pairs = _simulate(out / "drive", num_scans, console)
    with console.status("starting the node") as status:
        answers = _play(bag, len(pairs), out, lambda count: status.update(f"{count} of {len(pairs)} pairs decided"))
    judged = judge(pairs, answers.decisions, _covariances(answers))
    _write(judged, bag, out)
    console.print(decisions_table(judged))
    accepted = sum(j.result.accepted for j in judged)
    wrong = sum(j.is_wrong for j in judged)
    console.print(f"{len(judged)} pairs: {accepted} accepted, {wrong} of them wrong ({time.monotonic() - start:.0f} s)")
    if len(answers.transforms) != accepted:
        return f"{len(answers.transforms)} transforms for {accepted} accepted pairs"
    return verdict_on(judged)


def _simulate(folder: Path, num_scans: int, console: Console) -> tuple[Path, list[ExpectedPair]]:
    """A drive with a jump to another place in its middle; returns its bag and the pairs that will be played."""
    if num_scans < _MIN_SCANS:
        raise InputError(f"--scans: expected at least {_MIN_SCANS}, two on each side of the jump, found {num_scans}")
    if folder.exists():
        shutil.rmtree(folder)
    drive = DriveConfig(num_scans=num_scans, teleport_after=num_scans // 2 - 1)
    with console.status("") as status:

        def show(done: int, total: int) -> None:
            status.update(f"simulating scan {done} of {total}")

        summary = simulate_drive(folder, drive, show)
    console.print(f"simulated {summary.num_scans} scans over {summary.length_m:.0f} m, with a jump in the middle")
    reference = read_tum(summary.reference)
    return summary.bag, expected_pairs(reference.stamps_ns, reference.poses, STRIDE)


def _play(bag: Path, num_pairs: int, out: Path, on_decision: Callable[[int], None]) -> Answers:
    """Node and player as children, this process as the listener; returns what the node answered."""
    domain_id = own_domain_id()
    environment = local_environment(domain_id) | profile_environment()
    os.environ.update(environment)
    parameters = [part for name, value in _NODE_PARAMETERS.items() for part in ("-p", f"{name}:={value}")]
    player_args = [str(bag), "--stride", str(STRIDE), "--rate", "0", "--wait-decisions", "--wait-for-subscribers", "60"]
    rclpy.init(domain_id=domain_id)
    try:
        listener, executor = rclpy.create_node("svc_demo"), SingleThreadedExecutor()
        executor.add_node(listener)
        collector = DecisionCollector(listener, executor)
        with ChildProcess("svc_ros.ros.node", ["--ros-args", *parameters], environment, out / "node.log") as node:
            # The topic keeps one decision for who comes late: whoever wants all of them must be there before the first.
            spin_until(executor, lambda: listener.count_publishers(_DECISIONS) > 0 or node.exit_code is not None, 60.0)
            with ChildProcess("svc_ros.ros.bag_player", player_args, environment, out / "player.log") as player:
                for count in range(num_pairs):
                    on_decision(count)
                    _receive(collector, count + 1, node, player)
            accepted = sum(d["verdict"] == "accepted" for d in collector.answers.decisions)
            spin_until(executor, lambda: len(collector.answers.transforms) >= accepted, 5.0)
            spin_until(executor, lambda: False, 0.5)  # whatever comes now is one answer too many
        return collector.answers
    finally:
        rclpy.try_shutdown()


def _receive(collector: DecisionCollector, count: int, node: ChildProcess, player: ChildProcess) -> None:
    """Wait for the next decision; SvcError if a child ends before, or none comes in time."""
    end = time.monotonic() + _PAIR_TIMEOUT_S
    while not collector.wait_for_decisions(count, 0.2):
        if node.exit_code is not None or player.exit_code not in (None, 0):
            failed = player if node.exit_code is None else node
            raise SvcError(f"a process ended with exit code {failed.exit_code}; see {failed.log}")
        if time.monotonic() > end:
            raise SvcError(f"no decision on pair {count} in {_PAIR_TIMEOUT_S:g} s; see {node.log}")


def _write(judged: list[JudgedPair], bag: Path, out: Path) -> None:
    write_jsonl(out / "decisions.jsonl", map(record_of, judged))
    with ResultWriter(out / "results.mcap") as writer:
        for j in judged:
            frames = j.values["source_frame"], j.values["target_frame"]
            writer.write(j.result, j.pair.source_stamp_ns, j.pair.target_stamp_ns, *frames)
    with Bag(bag) as recorded:
        clouds = [reading.scan.points for reading in recorded.scans()]
    links = [Link.of(j.result, j.pair.source_index, j.pair.target_index) for j in judged]
    draw_overview(out / "overview.png", clouds, links, "Simulated drive, as the node aligned it")


def _covariances(answers: Answers) -> dict[int, Array]:
    return {ns_from_stamp(p.header.stamp): np.reshape(p.pose.covariance, (6, 6)) for p in answers.poses}


def _interrupt(_signum: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("demo", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for everything that is made")
    parser.add_argument("--scans", type=int, default=16, help="scans of the simulated drive")
    return parser


if __name__ == "__main__":
    sys.exit(main())
