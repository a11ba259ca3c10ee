"""A test bench over the real middleware: the node in a second process, and the other end of its topics here."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from yardstick import PATIENCE_S

from svc_ros.io.bags import Bag
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.ros.bag_player import CloudPlayer, ros_cloud
from svc_ros.ros.collector import DecisionCollector, spin_until
from svc_ros.ros.processes import ChildProcess, local_environment
from svc_ros.ros.registration_node import RegistrationNode
from svc_ros.ros.topics.conversions import cloud_message

RELIABLE_INPUTS = [f"qos_overrides./{side}_points.subscription.reliability:=reliable" for side in ("source", "target")]
SECOND = 1_000_000_000
Self = TypeVar("Self", bound="NodeBench")


class NodeBench:
    """A node in a second process, and a node here that listens to its decisions; subclasses say what they play."""

    name = "/svc_registration"

    def __init__(self, folder: Path, domain_id: int, settings: list[str]) -> None:
        args = ["--ros-args", *(part for setting in settings for part in ("-p", setting))]
        self.process = ChildProcess("svc_ros.ros.node", args, local_environment(domain_id), folder / "node.log")
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = Node("bench", context=self._context)
        self.executor = SingleThreadedExecutor(context=self._context)
        self.executor.add_node(self.node)
        self.collector = DecisionCollector(self.node, self.executor, self.name)

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        raise NotImplementedError

    def __enter__(self: Self) -> Self:
        self.process.__enter__()
        started = self.wait_for_subscribers(PATIENCE_S)
        ready = started and spin_until(self.executor, lambda: "ready:" in self.process.output(), PATIENCE_S)
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

    def decisions_on(self, stamp_ns: int) -> list[dict[str, str]]:
        return [d for d in self.answers.decisions if d["source_stamp"] == text_from_ns(stamp_ns)]

    def pause(self, seconds: float) -> None:
        """Receive for so long, and do nothing else."""
        spin_until(self.executor, lambda: False, seconds)

    def settle(self) -> None:
        """Receive what is still on its way; what was published and subscribed before has reached the node.

        A call by a new client overtakes neither messages nor the discovery of what was there before it.
        """
        assert spin_until(self.executor, lambda: self.status()["output"]["waiting"] == 0, PATIENCE_S)
        self.pause(0.1)

    def call(self, service_type, name: str, request):
        """The node's answer to a service call."""
        client = self.node.create_client(service_type, f"{self.name}/{name}")
        assert client.wait_for_service(timeout_sec=PATIENCE_S)
        future = client.call_async(request)
        assert spin_until(self.executor, future.done, PATIENCE_S)
        self.node.destroy_client(client)
        return future.result()

    def set_parameter(self, name: str, value) -> None:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.call(SetParameters, "set_parameters", request).results
        assert result.successful, result.reason

    def status(self):
        return json.loads(self.call(Trigger, "status", Trigger.Request()).message)


class Bench(NodeBench):
    """`with Bench(tmp_path, domain_id, {"preset": "lidar_indoor"}) as bench:` has a node that is ready for pairs."""

    def __init__(self, folder: Path, domain_id: int, parameters: dict[str, str] | None = None) -> None:
        settings = [f"{name}:={value}" for name, value in (parameters or {}).items()]
        super().__init__(folder, domain_id, [*RELIABLE_INPUTS, *settings])
        self.player = CloudPlayer(self.node, self.executor, "/source_points", "/target_points")

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        return self.player.wait_for_subscribers(timeout_s)

    def decide(self, source: PointCloud2, target: PointCloud2, timeout_s: float = PATIENCE_S) -> dict[str, str]:
        """Publish one pair and return its decision."""
        self.player.publish(source, target)
        stamp_ns = ns_from_stamp(source.header.stamp)
        assert self.collector.wait_for_decision_on(stamp_ns, timeout_s), self.process.output()
        (decision,) = self.decisions_on(stamp_ns)
        return decision


class StreamBench(NodeBench):
    """A node that follows a stream; what it says is in `answers`, `odometry` and `paths`."""

    def __init__(self, folder: Path, domain_id: int, parameters: dict[str, str]) -> None:
        settings = [f"{name}:={value}" for name, value in parameters.items()]
        reliable = [*RELIABLE_INPUTS, "qos_overrides./points.subscription.reliability:=reliable"]
        super().__init__(folder, domain_id, [*reliable, *settings])
        self.points = self.node.create_publisher(PointCloud2, "/points", QoSProfile(depth=100))
        self.odometry: list[Odometry] = []
        self.paths: list[PathMessage] = []
        self.node.create_subscription(Odometry, "/svc_registration/odometry", self.odometry.append, 100)
        self.node.create_subscription(PathMessage, "/svc_registration/path", self.paths.append, 10)

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        return spin_until(self.executor, self.points.get_subscription_count, timeout_s)

    def play(self, clouds: Iterable[PointCloud2], rate_hz: float) -> int:
        """Publish at that rate, and receive meanwhile; returns how many."""
        start, num_played = time.monotonic(), 0
        for num_played, message in enumerate(clouds, 1):
            self.points.publish(message)
            due = start + num_played / rate_hz
            spin_until(self.executor, lambda due=due: time.monotonic() >= due, 60.0)
        return num_played

    def decide(self, message: PointCloud2, timeout_s: float = PATIENCE_S) -> dict[str, str]:
        """Publish one scan and return its decision; an earlier one on the same stamp does not count."""
        stamp_ns = ns_from_stamp(message.header.stamp)
        before = len(self.decisions_on(stamp_ns))
        self.points.publish(message)
        is_decided = spin_until(self.executor, lambda: len(self.decisions_on(stamp_ns)) > before, timeout_s)
        assert is_decided, self.process.output()
        return self.decisions_on(stamp_ns)[-1]


class Host:
    """One context and one executor, as a user's own program has them."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.node = Node("host", context=self.context)
        self.executor.add_node(self.node)
        self.nodes: list[RegistrationNode] = []

    def start(self, name: str = "svc_registration", **parameters) -> RegistrationNode:
        """A node in this process."""
        reliable = {f"qos_overrides./{t}.subscription.reliability": "reliable" for t in
                    ("points", "source_points", "target_points")}  # fmt: skip
        values = {"preset": "lidar_indoor", "process_every": True, **reliable, **parameters}
        given = [Parameter(key, value=value) for key, value in values.items()]
        node = RegistrationNode(context=self.context, node_name=name, parameter_overrides=given)
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def call(self, service_type, name, request):
        client = self.node.create_client(service_type, name)
        assert spin_until(self.executor, client.service_is_ready, PATIENCE_S)
        future = client.call_async(request)
        assert spin_until(self.executor, future.done, PATIENCE_S)
        self.node.destroy_client(client)
        return future.result()

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, "/svc_registration/change_state", request).success

    def state(self) -> str:
        return self.call(GetState, "/svc_registration/get_state", GetState.Request()).current_state.label

    def status(self, name: str = "svc_registration"):
        return json.loads(self.call(Trigger, f"/{name}/status", Trigger.Request()).message)

    def close(self) -> None:
        for node in self.nodes:
            assert node.stop(PATIENCE_S)
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self.context.try_shutdown()


def recorded_clouds(bag_path: Path, topic: str | None = None) -> list[PointCloud2]:
    """The clouds of a bag as messages that can be published."""
    with Bag(bag_path) as bag:
        return [ros_cloud(message) for _, message in bag.raw_clouds(topic)]


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
