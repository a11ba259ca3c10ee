"""Starts the node and a driver, and listens to what the node says until the driver has ended."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from lib.common import child_environment
from lib.resident import resident_mb
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.middleware import PROFILE_VARIABLE, profile_path
from svc_ros.ros.processes import ChildProcess, own_domain_id

_READY_S, _DRAIN_S = 300.0, 30.0


@dataclass
class Heard:
    """Decisions as key-values, the last ~/status, the node's resident set [MB] each second, load of the machine."""

    sent: int = 0
    played_s: float = 0.0
    decisions: list[dict[str, str]] = field(default_factory=list)
    status: dict[str, Any] = field(default_factory=dict)
    resident_mb: list[float] = field(default_factory=list)
    load: float = 0.0


def listen(bag: Path, options: argparse.Namespace, folder: Path) -> Heard:
    """The whole run; ends the script where a process does not what it should."""
    domain_id = own_domain_id(31)
    environment = child_environment(domain_id)
    if options.profile:
        environment[PROFILE_VARIABLE] = str(profile_path())
    os.environ.update(environment)
    rclpy.init(domain_id=domain_id)
    node, executor = rclpy.create_node("listener"), SingleThreadedExecutor()
    executor.add_node(node)
    collector = DecisionCollector(node, executor)
    arguments = ["--ros-args", "-p", "mode:=scan_matching", "-p", f"preset:={options.preset}"]
    words = [str(bag), "/points", str(options.rate), str(options.seconds)]
    with ChildProcess("svc_ros.ros.node", arguments, environment, folder / "node.log") as registration:
        if not spin_until(executor, lambda: "ready:" in registration.output(), _READY_S):
            sys.exit(f"the node was not ready after {_READY_S:g} s:\n{registration.output()}")
        with ChildProcess("lib.live_driver", words, environment, folder / "driver.log") as driver:
            resident = _watch(executor, driver, registration.pid or 0)
            sent = re.search(r"sent (\d+) in ([\d.]+) s", driver.output())
        if sent is None:
            sys.exit(f"the driver failed:\n{driver.output()}")
        heard = Heard(int(sent[1]), float(sent[2]), collector.answers.decisions, {}, resident, os.getloadavg()[0])
        spin_until(executor, lambda: len(heard.decisions) >= heard.sent, _DRAIN_S)
        call = node.create_client(Trigger, "/svc_registration/status").call_async(Trigger.Request())
        if not spin_until(executor, call.done, _DRAIN_S):
            sys.exit(f"no ~/status:\n{registration.output()}")
        heard.status = json.loads(call.result().message)
    rclpy.try_shutdown()
    return heard


def _watch(executor: SingleThreadedExecutor, driver: ChildProcess, pid: int) -> list[float]:
    """The node's resident set [MB], once a second until the driver ends."""
    sizes: list[float] = []
    while driver.exit_code is None:
        due = time.monotonic() + 1.0
        spin_until(executor, lambda due=due: time.monotonic() > due or driver.exit_code is not None, 1.5)  # type: ignore[misc]
        sizes.append(resident_mb(pid))
    return sizes
