"""The other end of the node's topics: collects what it answers. Used by the demo and by the player."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from svc_ros.io.stamps import text_from_ns

_DEPTH = 1000
_DECISIONS = QoSProfile(
    depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


@dataclass
class Answers:
    """Everything that came, in order of arrival. `decisions` are the key-values of each decision."""

    decisions: list[dict[str, str]] = field(default_factory=list)
    transforms: list[TransformStamped] = field(default_factory=list)
    poses: list[PoseWithCovarianceStamped] = field(default_factory=list)
    rejected: list[bool] = field(default_factory=list)


class DecisionCollector:
    """Subscribes to a registration node's answers; `spin_until` receives them."""

    def __init__(self, node: Node, executor: SingleThreadedExecutor, name: str = "/svc_registration") -> None:
        self.answers = Answers()
        self._executor = executor
        node.create_subscription(DiagnosticArray, f"{name}/decision", self._on_decision, _DECISIONS)
        node.create_subscription(TransformStamped, f"{name}/transform", self.answers.transforms.append, _DEPTH)
        node.create_subscription(PoseWithCovarianceStamped, f"{name}/pose", self.answers.poses.append, _DEPTH)
        node.create_subscription(Bool, f"{name}/rejected", lambda m: self.answers.rejected.append(m.data), _DEPTH)

    def wait_for_decisions(self, count: int, timeout_s: float) -> bool:
        """Receive until there are `count` decisions in all; False when the time is over first."""
        return spin_until(self._executor, lambda: len(self.answers.decisions) >= count, timeout_s)

    def wait_for_decision_on(self, source_stamp_ns: int, timeout_s: float) -> bool:
        """Receive until the pair with this source stamp has its decision; False when the time is over first."""
        stamp = text_from_ns(source_stamp_ns)
        return spin_until(
            self._executor, lambda: any(d["source_stamp"] == stamp for d in self.answers.decisions), timeout_s
        )

    def _on_decision(self, message: DiagnosticArray) -> None:
        self.answers.decisions += [{kv.key: kv.value for kv in status.values} for status in message.status]


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool], timeout_s: float) -> bool:
    """Run callbacks until the condition holds; False when the time is over first."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        executor.spin_once(timeout_sec=0.05)
    return True
