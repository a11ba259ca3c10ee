"""What is wrong around the inputs, told while it lasts: publishers that do not fit, silence, stamps that jump back.

The log has one line when something begins, and one when it is over; /diagnostics has it in between.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from svc_ros.pipeline.stream import StampOrder
from svc_ros.ros.diagnostics import STALE_AFTER_S, InputMonitor, Statistics
from svc_ros.ros.middleware import cure

FORGOTTEN = {  # by mode: what is lost when time begins anew
    "pair": "clouds that waited and guesses are forgotten",
    "scan_matching": "clouds that waited and keyframes are forgotten, odometry begins anew",
    "loop_closure": "clouds that waited, odometry and keyframes are forgotten, a new graph begins",
    "localization": "clouds that waited and where the sensor is are forgotten, it is looked for anew",
}


@dataclass(frozen=True, eq=False)
class _Input:
    topic: str
    resolved: str
    qos: QoSProfile
    monitor: InputMonitor | None


class InputWatch:
    """Looks at the inputs of a node, whose `mode` says what is forgotten when stamps jump; not safe for several threads
    at once.
    """

    def __init__(self, node: Node, statistics: Statistics, mode: str) -> None:
        self._node, self._statistics, self._forgotten = node, statistics, FORGOTTEN[mode]
        self._inputs: dict[str, _Input] = {}
        self._silent: set[str] = set()
        self._told_losses: set[str] = set()
        self._orders: defaultdict[str, StampOrder] = defaultdict(StampOrder)

    def add(self, topic: str, qos: QoSProfile, monitor: InputMonitor | None = None) -> None:
        """Watch an input: its name before remapping, what it asks for, and for clouds when they came.

        One that is watched already is replaced.
        """
        self._inputs[topic] = _Input(topic, self._node.resolve_topic_name(topic), qos, monitor)

    def look(self, now_s: float) -> None:
        """Tell what has changed; to be called once a second. now_s: of the steady clock that the monitors have [s]."""
        for entry in list(self._inputs.values()):
            publishers = self._node.get_publishers_info_by_topic(entry.topic)
            self._tell_qos(entry, [p.qos_profile for p in publishers])
            if entry.monitor is not None and entry.topic not in self._statistics.qos_problems:
                self._tell_silence(entry, entry.monitor, now_s, len(publishers))
            self._tell_loss(entry, now_s)

    def stamped(self, name: str, stamp_ns: int) -> None:
        """A cloud with this stamp came on the input `name`: says so if its stamps jumped back."""
        if self._orders[name].is_jump(stamp_ns):
            is_stream = name == "points" or self._forgotten == FORGOTTEN["pair"]
            forgotten = self._forgotten if is_stream else "clouds that waited for a partner are forgotten"
            self._node.get_logger().warning(f"the stamps of {name} jumped back: {forgotten}")
            self._orders.clear()  # the other input of a pair follows, which is no second jump
        self._orders[name].lateness(stamp_ns)

    def clock_jumped(self) -> None:
        """Simulated time went back, and everything is forgotten: stamps may begin anew."""
        self._orders.clear()
        self._node.get_logger().warning(f"the clock jumped back: {self._forgotten}")

    def _tell_qos(self, entry: _Input, offered: list[QoSProfile]) -> None:
        problem, known = qos_problem(entry.resolved, offered, entry.qos), self._statistics.qos_problems
        if problem and entry.topic not in known:
            self._node.get_logger().error(f"{entry.resolved}: a publisher's QoS does not fit: {problem}")
        elif not problem and entry.topic in known:
            self._node.get_logger().info(f"{entry.resolved}: all publishers fit again")
        if problem:
            known[entry.topic] = problem
        else:
            known.pop(entry.topic, None)

    def _tell_silence(self, entry: _Input, monitor: InputMonitor, now_s: float, num_publishers: int) -> None:
        is_silent = monitor.is_needed and monitor.silence_s(now_s) > STALE_AFTER_S
        if is_silent and entry.topic not in self._silent:
            self._silent.add(entry.topic)
            self._node.get_logger().warning(silence_text(entry.topic, entry.resolved, num_publishers))
        elif not is_silent and entry.topic in self._silent:
            self._silent.discard(entry.topic)
            self._node.get_logger().info(f"clouds come on {entry.resolved}")

    def _tell_loss(self, entry: _Input, now_s: float) -> None:
        """Once, with what to do about it: what is lost later is in /diagnostics and ~/status."""
        lost = self._statistics.losses[entry.topic].warning(now_s)
        if lost and entry.topic not in self._told_losses:
            self._told_losses.add(entry.topic)
            self._node.get_logger().warning(f"{entry.resolved}: {lost} before they reached this node; {cure()}")


def qos_problem(resolved: str, offered: Iterable[QoSProfile], wanted: QoSProfile) -> str:
    """Why clouds of a publisher cannot be received, and which parameter changes that; empty if all fit."""
    for qos in offered:
        compatibility, reason = qos_check_compatible(qos, wanted)
        if compatibility == QoSCompatibility.ERROR:
            why = reason.replace("ERROR: ", "").strip("; ").replace(";", ",")
            cure = f"qos_overrides.{resolved}.subscription.reliability:=best_effort"
            return f"{why}; set {cure}, or make the publisher reliable"
    return ""


def silence_text(topic: str, resolved: str, num_publishers: int) -> str:
    """One line on an input that nothing comes on."""
    text = f"no clouds on {resolved} for {STALE_AFTER_S:g} s, it has {num_publishers} publisher(s): "
    if num_publishers:
        return f"{text}check that they send (ros2 topic hz {resolved}); if so, clouds are lost on their way: {cure()}"
    return text + f"check that the driver runs, its ROS_DOMAIN_ID, and the topic's name (-r {topic}:=/your/topic)"
