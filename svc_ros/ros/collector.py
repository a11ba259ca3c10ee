"""The other end of the node's topics: collects what it answers, and reads a decision back into a result."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from svc_ros.core.errors import InputError
from svc_ros.core.result import RegistrationResult
from svc_ros.io.results import result_from_json
from svc_ros.io.stamps import text_from_ns

_DEPTH = 1000
_TEXTS = {
    "verdict", "reason", "method", "detail", "source_stamp", "target_stamp", "source_frame", "target_frame",
    "T_target_source", "best_candidate", "weak_directions", "weak_direction_vectors",
}  # fmt: skip
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


def result_from_decision(values: Mapping[str, str]) -> RegistrationResult:
    """The result that a decision's key-values tell; InputError names the key that is missing or wrong.

    The message has how many sight lines are blocked, not which, and no covariance (that is in the pose).
    """
    numbers = {key: _number(key, text) for key, text in values.items() if _is_own_number(key)}
    record: dict[str, Any] = {name: values.get(name, "") for name in ("verdict", "reason", "method", "detail")}
    record |= {name: json.loads(values.get(name) or "null") for name in ("T_target_source", "best_candidate")}
    record["weak_directions"] = json.loads(values.get("weak_direction_vectors") or "null")
    record["probability"] = numbers.pop("probability", None)
    for group in ("counts", "time_ms"):
        members = [name for name in numbers if name.startswith(f"{group}.")]
        record[group] = {name.partition(".")[2]: numbers.pop(name) for name in members}
    record["counts"] = {name: int(count) for name, count in record["counts"].items()}
    record["evidence"] = numbers
    return result_from_json(record)


def _is_own_number(key: str) -> bool:
    """True for the result's numbers; the node's own latencies end in _ms and are not the result's."""
    return key not in _TEXTS and not key.endswith("_ms")


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"decision: {key}: expected a number, found {text!r:.40}") from None


def spin_until(executor: SingleThreadedExecutor, condition: Callable[[], bool], timeout_s: float) -> bool:
    """Run callbacks until the condition holds; False when the time is over first."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        executor.spin_once(timeout_sec=0.05)
    return True
