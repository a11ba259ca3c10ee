"""Where the keyframes of a loop closure stood after its loops, told while they come."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from svc_ros.core.errors import MissingDependencyError
from svc_ros.io.g2o import PoseGraph
from svc_ros.io.trajectories import Trajectory
from svc_ros.pipeline.graph_optimisation import optimise_poses
from svc_ros.ros.topics.conversions import header, plain_pose

_log = logging.getLogger(__name__)
_LAST_PATH = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class OptimisedPath:
    """Publishes `~/optimized_path`: odometry's keyframes as the accepted loops have them.

    graph: a number that grows with every change of the loops, and the keyframes with their graph, None where there are
    none; frame: of odometry, asked for each time. It is computed on a thread of its own, by gtsam.
    """

    def __init__(
        self, node: Node, graph: Callable[[], tuple[int, Trajectory, PoseGraph] | None], frame: Callable[[], str]
    ) -> None:
        self._node, self._graph, self._frame = node, graph, frame
        self._publisher = node.create_publisher(Path, "~/optimized_path", _LAST_PATH)
        self._told, self._has_path, self._is_possible = 0, False, True
        self._thread: threading.Thread | None = None

    def tell(self) -> None:
        """Compute and send the path anew, if loops have changed and somebody listens; called once a second.

        After a reset, until there are keyframes again, it is an empty one: the last path is kept for who comes later.
        """
        is_busy = self._thread is not None and self._thread.is_alive()
        if is_busy or not self._is_possible or not self._publisher.get_subscription_count():
            return
        found = self._graph()
        if found is None and self._has_path:
            self._has_path = False
            self._publisher.publish(Path(header=header(0, self._frame())))
        if found is None or found[0] == self._told:
            return
        self._told, self._has_path = found[0], True
        self._thread = threading.Thread(target=self._send, args=found[1:], name="optimised path", daemon=True)
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Wait for what is being computed."""
        self._is_possible = False
        if self._thread is not None:
            self._thread.join(timeout_s)

    def destroy(self) -> None:
        """Give the publisher back; `stop` comes first."""
        self._node.destroy_publisher(self._publisher)

    # on the thread of its own

    def _send(self, keyframes: Trajectory, graph: PoseGraph) -> None:
        try:
            poses, frame = optimise_poses(graph), self._frame()
            path = Path(header=header(int(keyframes.stamps_ns[-1]), frame))
            path.poses = [
                PoseStamped(header=header(int(stamp), frame), pose=plain_pose(T))
                for stamp, T in zip(keyframes.stamps_ns, poses, strict=True)
            ]
            self._publisher.publish(path)
        except MissingDependencyError as error:
            self._is_possible = False
            self._node.get_logger().warning(f"optimized_path: {error}")
        except InvalidHandle:
            pass  # given back meanwhile
        except Exception:
            if self._node.context.ok():
                _log.exception("the optimized path could not be told")
