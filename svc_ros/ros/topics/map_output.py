"""Where odometry stands in a map, for navigation: from accepted pairs with known places, or localization."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from svc_ros.core.errors import TransformUnavailableError
from svc_ros.core.scan import Array
from svc_ros.core.se3 import invert
from svc_ros.ros.parameters import NodeSettings
from svc_ros.ros.streams.decision import Decision
from svc_ros.ros.streams.localization_engine import TOLD
from svc_ros.ros.topics.conversions import transform_message
from svc_ros.ros.topics.frames import Frames, TransformOutput

_log = logging.getLogger(__name__)
_PERIOD_S = 0.05  # four of them within the tolerance that transforms are dated ahead by
_BACK_NS = 1_000_000_000  # a clock that goes back by more has begun anew


class MapOutput:
    """Sends `map_frame` to `odom_frame` on /tf again and again, once a pair or a place was accepted; before, nothing.

    Between acceptances the last one holds: odometry carries it on. Nothing else changes it, but that it is forgotten
    when asked to, when localization is lost, or when the node's clock goes back. Raises MissingDependencyError without
    tf2_msgs.

    frames: where the source stands in `odom_frame`, and the target in `map_frame`; is_active: send at this moment.
    """

    def __init__(self, node: Node, settings: NodeSettings, frames: Frames, is_active: Callable[[], bool]) -> None:
        self._node, self._settings, self._frames, self._is_active = node, settings, frames, is_active
        self._tf = TransformOutput(node, "publish_tf" if settings.mode == "localization" else "map_frame")
        self._found: tuple[Array, int] | None = None  # T_map_odom, and when it was found by the node's clock
        self._problem, self._num_updates, self._last_stamp_ns = "", 0, -1
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def update(self, decision: Decision, settings: NodeSettings) -> None:
        """Take over what an accepted one says; the worker calls this with every decision. May wait for TF."""
        self._settings = settings
        if decision.place is not None and decision.place.T_map_odom is None:
            self.forget()
        if not decision.result.accepted or decision.origin == TOLD:
            return
        try:
            T_map_odom = self._locate(decision, settings)
        except TransformUnavailableError as error:
            self._problem = str(error)
            self._node.get_logger().warning(f"map_frame: an accepted pair is not used: {error}")
            return
        self._found = T_map_odom, self._node.get_clock().now().nanoseconds
        self._problem, self._num_updates = "", self._num_updates + 1
        if self._thread is None:
            frames = f"{settings.frame_of_map} to {settings.odom_frame}"
            self._node.get_logger().info(f"map_frame: {frames} is on /tf from now on")
            self._thread = threading.Thread(target=self._run, name="map frame", daemon=True)
            self._thread.start()

    def forget(self) -> None:
        """Send nothing until the next acceptance."""
        self._found, self._problem = None, ""

    def numbers(self) -> dict[str, Any]:
        """How many pairs were taken over, and why the last accepted one was not; safe from any thread."""
        return {"map_updates": self._num_updates, "map_problem": self._problem}

    def stop(self) -> None:
        """Send nothing any more."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()

    def destroy(self) -> None:
        """Give the publisher back."""
        self.stop()
        self._tf.destroy()

    def _locate(self, decision: Decision, settings: NodeSettings) -> Array:
        """T_map_odom (4, 4); TransformUnavailableError says what is missing."""
        if decision.place is not None and decision.place.T_map_odom is not None:
            return decision.place.T_map_odom
        result, source, target = decision.result, decision.source, decision.target
        assert result.T_target_source is not None
        assert source is not None
        assert target is not None
        if source.frame_id in (target.frame_id, settings.map_frame):
            found = f"target in {target.frame_id!r}, source in {source.frame_id!r}"
            raise TransformUnavailableError(f"expected clouds in frames of their own, found {found}")
        # By static transforms alone: otherwise the target's place could come from odometry and this very transform.
        T_map_target = self._frames.fixed_pose(settings.map_frame, target.frame_id, settings.tf_timeout)
        T_odom_source = self._frames.pose(settings.odom_frame, source.frame_id, source.stamp_ns, settings.tf_timeout)
        return T_map_target @ result.T_target_source @ invert(T_odom_source)

    # on a thread of its own: transforms stay fresh whatever worker and executor have to do

    def _run(self) -> None:
        while not self._over.wait(_PERIOD_S):
            try:
                self._send()
            except Exception:
                if not self._node.context.ok():
                    return  # shut down meanwhile: nobody listens any more
                _log.exception("the map's transform could not be sent")

    def _send(self) -> None:
        found, settings = self._found, self._settings
        if found is None or not self._is_active():
            return
        T_map_odom, found_ns = found
        now_ns = self._node.get_clock().now().nanoseconds
        if now_ns < found_ns - _BACK_NS:
            self._found = None
            return
        stamp_ns = now_ns + round(1e9 * settings.transform_tolerance)
        if stamp_ns != self._last_stamp_ns:  # tf2 complains of a stamp that it has: simulated time stands still
            self._last_stamp_ns = stamp_ns
            self._tf.publish(transform_message(T_map_odom, stamp_ns, settings.frame_of_map, settings.odom_frame), "")
