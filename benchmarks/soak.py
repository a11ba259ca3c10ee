"""Does the node stay right when far more comes than it can serve? A bag, played several times too fast.

    python benchmarks/soak.py [--seconds S] [--factor F] [--modes MODE ...] [--bag BAG] [--out DIR]

First one pair or scan at a time, to see how many a second the node serves; then F times as many. Everything is looked
at from outside, over DDS: each decision, ~/status twice a second, and a 100 Hz timer in the node's process. Writes
soak.json; exit code 1 if a check fails.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import tempfile
from itertools import cycle, repeat
from pathlib import Path
from typing import TYPE_CHECKING

from lib.common import DEFAULT_DATA, console, describe_run, parse_options, print_table, write_report
from lib.soak_checks import Record, checks, summary

if TYPE_CHECKING:
    from lib.soak_bench import Clouds
    from sensor_msgs.msg import PointCloud2

MODES = ("pair", "scan_matching", "loop_closure")
SHARE_ALONE = 0.2  # of the time, in which pairs or scans come one at a time
MAX_MB_PER_S = 60.0  # beyond this the player and the middleware are measured, not the node
COLUMNS = ("published", "snapshots", "queue_max", "growth_mb", "late_ms_p99")


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--seconds", type=float, default=90.0, help="time of play of all modes together")
        parser.add_argument("--factor", type=float, default=10.0, help="times as fast as the node serves")
        parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES)
        parser.add_argument("--bag", type=Path, default=DEFAULT_DATA.parent / "bags" / "os0_64_walk" / "ros2_mcap")
        parser.add_argument("--preset", default="lidar_indoor", help="of the bag")

    options = parse_options("The node under more load than it can serve.", extend, workers=False)
    if importlib.util.find_spec("rclpy") is None:
        sys.exit("expected rclpy, found none: pip install 'svc_ros[ros]'")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    run = describe_run([])
    clouds = read_clouds(options.bag)
    records = [soak(mode, clouds, options) for mode in options.modes]
    found = {record.mode: summary(record) for record in records}
    about = {"seconds": options.seconds, "factor": options.factor, "bag": options.bag.name, "preset": options.preset}
    print_table("Under load", ["mode", *COLUMNS], [[mode, *(v[c] for c in COLUMNS)] for mode, v in found.items()])
    write_report(options.out / "soak.json", {**about, "modes": found}, run)
    failed = [f"{record.mode}: {name}" for record in records for name, holds in checks(record).items() if not holds]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")
    console.print("all checks hold")


def read_clouds(bag_path: Path) -> list[PointCloud2]:
    """The clouds of a bag there and back again, so that each is a step away from the one before it."""
    from svc_ros.core.errors import SvcError
    from svc_ros.io.bags import Bag
    from svc_ros.ros.bag_player import ros_cloud

    try:
        with Bag(bag_path) as bag:
            there = [ros_cloud(message) for _, message in bag.raw_clouds(None)]
    except SvcError as error:
        sys.exit(f"{error} (--bag names the bag)")
    return [*there, *reversed(there[1:-1])]


def soak(mode: str, clouds: list[PointCloud2], options: argparse.Namespace) -> Record:
    """What the node tells while one mode is played alone and then too fast."""
    from lib.soak_bench import NodeUnderLoad

    seconds = options.seconds / len(options.modes)
    with tempfile.TemporaryDirectory() as folder, NodeUnderLoad(mode, options.preset, Path(folder)) as node:
        node.play_alone(in_turn(mode, clouds, 1), SHARE_ALONE * seconds)
        rate_hz = min(options.factor * node.record.served_per_s, largest_rate(mode, clouds))
        console.print(f"{mode}: serves {node.record.served_per_s:.3g} a second, gets {rate_hz:.3g}")
        node.play_fast(in_turn(mode, clouds, round(options.factor)), rate_hz, (1.0 - SHARE_ALONE) * seconds)
        node.finish()
    return node.record


def in_turn(mode: str, clouds: list[PointCloud2], times: int) -> Clouds:
    """Without end: each cloud with the one before it, or each scan `times` times, as a sensor that fast sees it."""
    if mode == "pair":
        yield from cycle(list(zip([*clouds[1:], clouds[0]], clouds, strict=True)))
    while True:
        for cloud in clouds:
            yield from repeat((cloud,), times)


def largest_rate(mode: str, clouds: list[PointCloud2]) -> float:
    """Pairs or scans a second that the player may send at most."""
    mb = sum(len(cloud.data) for cloud in clouds) / len(clouds) / 1e6
    return MAX_MB_PER_S / (mb * (2 if mode == "pair" else 1))


if __name__ == "__main__":
    main()
