"""What loses big clouds on their way, and what does not: a driver and a listener in two processes, best effort.

    python benchmarks/arrival.py [--points N] [--rate HZ] [--count N] [--out DIR]

Each row is one way to set the two sides: nothing, config/fastdds_large_clouds.xml on either or both, and the
transports that the node gives itself. Writes arrival.json with the share that arrived and the kernel's setting.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys

from lib.common import child_environment, console, describe_run, parse_options, print_table, write_report

CASES = (  # driver, listener
    ("defaults", "defaults"),
    ("defaults", "profile"),
    ("profile", "defaults"),
    ("profile", "profile"),
    ("defaults", "as the node"),
    ("profile", "as the node"),
    ("UDPv4", "as the node"),
    ("LARGE_DATA", "defaults"),
    ("LARGE_DATA", "as the node"),
)
START_S = 6.0  # to start both, and to meet


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--points", type=int, default=130_000, help="points of 16 bytes in each cloud")
        parser.add_argument("--rate", type=float, default=10.0, help="clouds a second on each topic")
        parser.add_argument("--count", type=int, default=50, help="clouds on each topic")
        parser.add_argument("--topics", default="/source_points,/target_points", help="with commas between")

    options = parse_options("What arrives of big clouds.", extend, workers=False)
    from svc_ros.ros.middleware import largest_socket_buffer

    run, rows = describe_run([]), []
    for driver, listener in CASES:
        sent, received = play(driver, listener, options)
        rows.append({"driver": driver, "listener": listener, "sent": sent, "received": received})
        console.print(f"{driver:12s} -> {listener:12s} {received} of {sent}")
    settings = {name: getattr(options, name) for name in ("points", "rate", "count", "topics")}
    print_table("Clouds that arrive", list(rows[0]), [list(row.values()) for row in rows])
    more = {"rmem_max": largest_socket_buffer(), "load": os.getloadavg()[0]}
    write_report(options.out / "arrival.json", {**settings, **more, "cases": rows}, run)


def play(driver: str, listener: str, options: argparse.Namespace) -> tuple[int, int]:
    """Clouds that were sent, and that were received."""
    seconds = START_S + options.count / options.rate
    role = "receive_as_the_node" if listener == "as the node" else "receive"
    receiver = start([role, options.topics, str(seconds)], listener)
    words = ["send", options.topics, str(options.points), str(options.rate), str(options.count)]
    sender = start(words, driver)
    return ending(sender, "sent"), ending(receiver, "received")


def start(words: list[str], setting: str) -> subprocess.Popen[str]:
    """One side, with that setting of its transports."""
    from svc_ros.ros.middleware import PROFILE_VARIABLE, profile_path
    from svc_ros.ros.processes import own_domain_id

    environment = child_environment(own_domain_id(97))
    if setting == "profile":
        environment[PROFILE_VARIABLE] = str(profile_path())
    if setting in ("UDPv4", "LARGE_DATA"):
        environment["FASTDDS_BUILTIN_TRANSPORTS"] = setting
    command = [sys.executable, "-m", "lib.arrival_peer", *words]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def ending(process: subprocess.Popen[str], word: str) -> int:
    """The number that a process ends with; ends the script where there is none."""
    found = re.search(rf"{word} (\d+)", process.communicate()[0])
    if found is None:
        sys.exit(f"a process did not say what it has {word}")
    return int(found[1])


if __name__ == "__main__":
    main()
