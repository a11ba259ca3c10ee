"""The registration node with a 100 Hz timer beside it, in one process and one executor.

Publishes once a second on LATENESS_TOPIC: this process's resident set [MB], then the lateness [ms] of each tick since
the message before.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from types import FrameType
from typing import NoReturn

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

from lib.resident import resident_mb
from svc_ros.ros.registration_node import RegistrationNode

LATENESS_TOPIC = "/soak/lateness"
PERIOD_S = 0.01
_JOIN_S = 20.0


class Heart:
    """A 100 Hz timer on a steady clock that writes down how late it is."""

    def __init__(self, node: Node) -> None:
        self._late_ms: list[float] = []
        self._last_s = time.monotonic()
        self._publisher = node.create_publisher(Float32MultiArray, LATENESS_TOPIC, QoSProfile(depth=100))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD_S, self._tick, clock=steady)
        node.create_timer(1.0, self._tell, clock=steady)

    def _tick(self) -> None:
        now = time.monotonic()
        self._late_ms.append(1e3 * max(now - self._last_s - PERIOD_S, 0.0))
        self._last_s = now

    def _tell(self) -> None:
        self._publisher.publish(Float32MultiArray(data=[resident_mb(), *self._late_ms]))
        self._late_ms.clear()


def main() -> int:
    """Run until told to stop."""
    signal.signal(signal.SIGTERM, _interrupt)
    rclpy.init()
    node, beside = RegistrationNode(), Node("soak_heart")
    heart, executor = Heart(beside), SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(beside)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()
    del heart
    node.stop(_JOIN_S)
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    beside.destroy_node()
    rclpy.try_shutdown()
    return 0


def _interrupt(_signum: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
