"""The node in a second process under load, and the other end of its topics here."""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float32MultiArray
from std_srvs.srv import Trigger

from lib.common import child_environment
from lib.soak_checks import MAX_KEYFRAMES, Record, Snapshot
from lib.soak_node import LATENESS_TOPIC
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import ChildProcess, own_domain_id
from svc_ros.ros.topics.conversions import header

TOPICS = {"pair": ("source_points", "target_points"), "scan_matching": ("points",), "loop_closure": ("points",)}
Clouds = Iterator[tuple[PointCloud2, ...]]  # what is published at once, in the order of the topics

_STATUS_EVERY_S, _ANSWER_S, _DRAIN_S, _READY_S = 0.5, 10.0, 60.0, 120.0
_DEPTH = 100  # what the middleware loses nobody can count
_QUEUE_SIZE = 2
_SECOND = 1_000_000_000
# Of each mode; keyframe stores that are full soon, so that growth can be seen. Of a loop at most one candidate is
# judged: each scan then has one decision or none, and can be counted.
_OWN_SETTINGS = {
    "pair": {},
    "scan_matching": {"scan_matching.max_keyframes": MAX_KEYFRAMES},
    "loop_closure": {
        "scan_matching.max_keyframes": MAX_KEYFRAMES, "loop_closure.max_keyframes": MAX_KEYFRAMES,
        "loop_closure.min_gap_s": 0.3, "loop_closure.keyframe_distance_m": 0.5,
        "loop_closure.max_near": 1, "loop_closure.max_similar": 0,
    },
}  # fmt: skip


class NodeUnderLoad:
    """`with NodeUnderLoad(mode, preset, folder) as node:` has a node that is ready; `record` is what it told."""

    def __init__(self, mode: str, preset: str, folder: Path) -> None:
        self.record = Record(mode, _QUEUE_SIZE)
        domain_id = own_domain_id(70 + len(mode))
        arguments, environment = _arguments(mode, preset), child_environment(domain_id)
        self.process = ChildProcess("lib.soak_node", arguments, environment, folder / "log")
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self._node = Node("soak", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        qos = QoSProfile(depth=_DEPTH)
        self._publishers = [self._node.create_publisher(PointCloud2, f"/{topic}", qos) for topic in TOPICS[mode]]
        self._collector = DecisionCollector(self._node, self._executor)
        self._status = self._node.create_client(Trigger, "/svc_registration/status")
        self._node.create_subscription(Float32MultiArray, LATENESS_TOPIC, self._on_lateness, qos)
        self._published, self._stamp_ns, self._is_loaded = 0, _SECOND, False

    def __enter__(self) -> NodeUnderLoad:
        self.process.__enter__()
        publishers = self._publishers
        is_heard = self._spin(lambda: all(p.get_subscription_count() for p in publishers), _READY_S)
        if not (is_heard and self._spin(lambda: "ready:" in self.process.output(), _READY_S)):
            self.__exit__()
            sys.exit(f"the node was not ready after {_READY_S:g} s:\n{self.process.output()}")
        return self

    def __exit__(self, *_exception: object) -> None:
        self.process.__exit__()
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._context.try_shutdown()

    def play_alone(self, clouds: Clouds, seconds: float) -> None:
        """One after the other, each when the last one has its decision."""
        start, count = time.monotonic(), 0
        while time.monotonic() - start < seconds or count < 2:
            count += 1
            self._publish(next(clouds), _SECOND)
            if not self._spin(lambda due=count: self._num_done() >= due, _DRAIN_S):
                sys.exit(f"no answer in {_DRAIN_S:g} s:\n{self.process.output()}")
        self.record.served_per_s = count / (time.monotonic() - start)

    def play_fast(self, clouds: Clouds, rate_hz: float, seconds: float) -> None:
        """At that rate; the node is asked for its status meanwhile."""
        self._is_loaded = True
        start = asked = time.monotonic()
        count = 0
        while (now := time.monotonic()) - start < seconds:
            if now - start >= count / rate_hz:
                self._publish(next(clouds), round(_SECOND / rate_hz))
                count += 1
            if now - asked > _STATUS_EVERY_S:
                asked = now
                self._ask()
            due = start + count / rate_hz - time.monotonic()
            self._executor.spin_once(timeout_sec=min(max(due, 0.0), 0.05))
        self._is_loaded = False
        self.record.played_per_s = count / (time.monotonic() - start)

    def finish(self) -> None:
        """Wait until everything has its decision, and ask for the status once more."""
        end, pending = time.monotonic() + _DRAIN_S, 1
        while pending and time.monotonic() < end:
            self._spin(lambda: False, 0.5)
            future = self._ask()
            if self._spin(future.done, _ANSWER_S):
                status = self.record.snapshots[-1].status
                pending = status["jobs"]["pending"] + status["output"]["waiting"]
        self._spin(lambda: False, 1.0)  # whatever comes now is one answer too many
        self.record.decided = self._decided()
        self.record.is_alive = self.process.exit_code is None and "Traceback" not in self.process.output()

    def _num_done(self) -> int:
        """Pairs or scans that the node is done with; in loop closure some of them have no decision."""
        if self.record.mode != "loop_closure":
            return len(self._collector.answers.decisions)
        future = self._ask()
        if not self._spin(future.done, _ANSWER_S):
            return 0
        jobs = json.loads(future.result().message)["jobs"]
        return int(jobs["received"] - jobs["pending"])

    def _publish(self, clouds: tuple[PointCloud2, ...], step_ns: int) -> None:
        self._stamp_ns += step_ns
        for publisher, cloud in zip(self._publishers, clouds, strict=True):
            cloud.header = header(self._stamp_ns, cloud.header.frame_id)
            publisher.publish(cloud)
            self._published += 1

    def _ask(self) -> Future:
        before = self._decided()
        future: Future = self._status.call_async(Trigger.Request())

        def keep(done: Future) -> None:
            status = json.loads(done.result().message)
            self.record.snapshots.append(Snapshot(status, before, self._published))

        future.add_done_callback(keep)
        return future

    def _decided(self) -> Counter[str]:
        return Counter(values["verdict"] for values in self._collector.answers.decisions)

    def _on_lateness(self, message: Float32MultiArray) -> None:
        if self._is_loaded:
            resident, *late = message.data
            self.record.resident_mb.append(resident)
            self.record.late_ms += late

    def _spin(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        return spin_until(self._executor, condition, timeout_s)


def _arguments(mode: str, preset: str) -> list[str]:
    settings = [f"mode:={mode}", f"preset:={preset}", f"queue_size:={_QUEUE_SIZE}"]
    settings += [f"{name}:={value}" for name, value in _OWN_SETTINGS[mode].items()]
    for topic in TOPICS[mode]:
        values = ("reliability:=reliable", f"depth:={_DEPTH}")
        settings += [f"qos_overrides./{topic}.subscription.{value}" for value in values]
    return ["--ros-args", *(part for setting in settings for part in ("-p", setting))]
