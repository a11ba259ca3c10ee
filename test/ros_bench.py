"""A test bench over the real middleware: the node in a second process, and the other end of its topics here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.ros.bag_player import PairPlayer
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.conversions import cloud_message
from svc_ros.ros.processes import ChildProcess, local_environment

RELIABLE_INPUTS = [f"qos_overrides./{side}_points.subscription.reliability:=reliable" for side in ("source", "target")]
SECOND = 1_000_000_000


class Bench:
    """`with Bench(tmp_path, domain_id, {"preset": "lidar_indoor"}) as bench:` has a node that is ready."""

    def __init__(self, folder: Path, domain_id: int, parameters: dict[str, str] | None = None) -> None:
        settings = [f"{name}:={value}" for name, value in (parameters or {}).items()]
        args = ["--ros-args", *(part for setting in [*settings, *RELIABLE_INPUTS] for part in ("-p", setting))]
        self.process = ChildProcess("svc_ros.ros.node", args, local_environment(domain_id), folder / "node.log")
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = Node("bench", context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self.collector = DecisionCollector(self.node, self.executor)
        self.player = PairPlayer(self.node, self.executor, "/source_points", "/target_points")

    def __enter__(self) -> Bench:
        self.process.__enter__()
        started = self.player.wait_for_subscribers(30.0)
        ready = started and spin_until(self.executor, lambda: "ready:" in self.process.output(), 60.0)
        if not ready:
            self.__exit__()
        assert ready, self.process.output()
        return self

    def __exit__(self, *_exception: object) -> None:
        self.process.__exit__()
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self._context.try_shutdown()

    @property
    def answers(self):
        return self.collector.answers

    def decide(self, source: PointCloud2, target: PointCloud2, timeout_s: float = 60.0) -> dict[str, str]:
        """Publish one pair and return its decision."""
        self.player.publish(source, target)
        stamp_ns = ns_from_stamp(source.header.stamp)
        assert self.collector.wait_for_decision_on(stamp_ns, timeout_s), self.process.output()
        (decision,) = self.decisions_on(stamp_ns)
        return decision

    def decisions_on(self, stamp_ns: int) -> list[dict[str, str]]:
        return [d for d in self.answers.decisions if d["source_stamp"] == text_from_ns(stamp_ns)]

    def settle(self, seconds: float = 0.5) -> None:
        """Receive what is still on its way."""
        spin_until(self.executor, lambda: False, seconds)


def cloud(points: np.ndarray, stamp_s: float, frame_id: str = "lidar") -> PointCloud2:
    return cloud_message(points, round(stamp_s * SECOND), frame_id)


def matrix(transform) -> np.ndarray:
    """(4, 4) of a TransformStamped."""
    from scipy.spatial.transform import Rotation

    t, q = transform.transform.translation, transform.transform.rotation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = t.x, t.y, t.z
    return T
