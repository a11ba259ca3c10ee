"""What comes in: clouds, guesses and odometry by topic. Callbacks pair, keep and pass on; nothing is computed here."""

from __future__ import annotations

import contextlib
import copy
import functools
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy._rclpy_pybind11 import RCLError
from rclpy.event_handler import QoSMessageLostInfo, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from svc_ros.core.errors import ConfigError, InputError
from svc_ros.io.clouds.point_cloud2 import CloudMessage
from svc_ros.io.stamps import ns_from_stamp, text_from_ns
from svc_ros.pipeline.pairing import Event, Matched, Side, StampPairer
from svc_ros.ros.diagnostics import InputMonitor, Statistics
from svc_ros.ros.parameters import NodeParameters
from svc_ros.ros.streams.worker import Cloud, DropJob, Job, PairJob, ScanJob
from svc_ros.ros.topics.cloud_topic import CloudSource, CloudTopic
from svc_ros.ros.topics.conversions import pose_from_message
from svc_ros.ros.topics.input_watch import InputWatch
from svc_ros.ros.topics.poses import PoseBuffer
from svc_ros.ros.topics.told_poses import StampedPose, ToldPoses

_KEPT_GUESSES, _KEPT_ODOMETRY = 16, 1000
_MOST_APART_NS = 10_000_000_000  # a pose that is told by another clock is of no use
_RELIABLE = QoSProfile(depth=10)
_ODOMETRY_DEPTH = QoSProfile(depth=100)
# Clouds that the middleware keeps while the executor has no time for them; with `process_every` none may be lost.
_DEPTH, _DEPTH_OF_EVERY = 20, 100

CLOUD_INPUTS: dict[str, dict[str, bool]] = {  # of each mode: name, and whether the mode cannot do without it
    "pair": {"source": True, "target": True},
    "scan_matching": {"points": True},
    "loop_closure": {"points": True, "source": False, "target": False},
    "localization": {"points": True},
}


class Inputs:
    """Subscribes to what the mode needs, and gives each pair, scan or cloud without a partner to `take`.

    `guesses`, `odometry` and `told` may be read from any thread. lock: held while clouds are paired and counted, so
    that an executor with several threads may call everything here; who holds it sees counts that fit each other.
    """

    def __init__(
        self, node: Node, parameters: NodeParameters, statistics: Statistics, take: Callable[[Job], None]
    ) -> None:
        self._node, self._parameters, self._statistics, self._take = node, parameters, statistics, take
        self.pairer: StampPairer[Cloud] = StampPairer(parameters.settings.max_skew_ns)
        self.lock = threading.RLock()
        self.guesses, self.odometry, self.told = PoseBuffer(_KEPT_GUESSES), PoseBuffer(_KEPT_ODOMETRY), ToldPoses()
        self.odometry_child_frame = ""
        self._last_cloud_s = time.monotonic()
        self._last_stamp_ns = 0
        self._subscriptions: list[Subscription] = []
        self._cloud_topics: list[CloudTopic] = []
        settings = parameters.settings
        self.watch = InputWatch(node, statistics, settings.mode)
        with contextlib.ExitStack() as undo:
            undo.callback(self.destroy)
            names = CLOUD_INPUTS[settings.mode]
            for name in names:
                self._subscribe_clouds(name)
            if "source" in names:
                self._keep_subscribed(PoseWithCovarianceStamped, "initial_guess", self._on_guess, _RELIABLE)
            if settings.mode == "localization" and settings.told_by == "topic":
                self._keep_subscribed(PoseWithCovarianceStamped, "initialpose", self._on_told, _RELIABLE)
            if settings.mode in ("loop_closure", "localization") and settings.odometry == "topic":
                self._keep_subscribed(Odometry, "odom", self._on_odometry, _ODOMETRY_DEPTH)
            undo.pop_all()

    def give_up_waiting(self) -> None:
        """Answer what waits for a partner when clouds have not come for `pair_timeout`; to be called now and then."""
        timeout = self._parameters.settings.pair_timeout
        with self.lock:
            if timeout and self.pairer.num_waiting and time.monotonic() - self._last_cloud_s > timeout:
                self._take_events(self.pairer.flush())

    def clear(self) -> None:
        """Forget everything that waits; clouds without a partner get their answer."""
        with self.lock:
            self._take_events(self.pairer.clear())
        self.guesses.clear()
        self.odometry.clear()
        self.told.clear()

    def look(self) -> None:
        """Tell what is wrong around the inputs, and take clouds as what is sent; to be called once a second."""
        with self.lock:
            self.watch.look(time.monotonic())
        for topic in self._cloud_topics:
            topic.look()

    def is_ahead_of(self, now_ns: int) -> bool:
        """True if the last cloud is of a time that has not come yet: the clock has jumped back."""
        return self._last_stamp_ns > now_ns

    def destroy(self) -> None:
        """Give the subscriptions back."""
        for topic in self._cloud_topics:
            topic.destroy()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _subscribe_clouds(self, name: str) -> None:
        qos = copy.copy(qos_profile_sensor_data)
        qos.depth = _DEPTH_OF_EVERY if self._parameters.settings.process_every else _DEPTH
        topic, take = "points", self._on_scan
        if name != "points":
            side: Side = "source" if name == "source" else "target"
            topic, take = f"{name}_points", functools.partial(self._on_cloud, side)

        monitor = self._statistics.inputs[name]

        def subscribe(source: CloudSource) -> Subscription:
            return self._subscribe(source.message_class, topic, source.callback, qos, source.is_raw, monitor)

        self._cloud_topics.append(CloudTopic(self._node, topic, subscribe, take, self._statistics.type_problems))

    def _keep_subscribed(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        self._subscriptions.append(self._subscribe(kind, topic, callback, qos))

    def _subscribe(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile, is_raw: bool = False,
        monitor: InputMonitor | None = None,
    ) -> Subscription:  # fmt: skip
        def on_incompatible(_info: object) -> None:
            with self.lock:
                self.watch.look(time.monotonic())

        loss = self._statistics.losses[topic]
        publishers = functools.partial(self._node.count_publishers, self._node.resolve_topic_name(topic))

        def on_lost(info: QoSMessageLostInfo) -> None:
            loss.report(info.total_count_change, time.monotonic())

        def on_message(message: Any, about: Mapping[str, Any]) -> None:
            number = about["publication_sequence_number"]
            loss.take(number if publishers() == 1 else None, time.monotonic())
            callback(message)

        wanted = copy.copy(qos)  # rclpy writes what is overridden into the profile that it is given
        try:
            subscription = self._node.create_subscription(
                kind, topic, on_message, wanted, raw=is_raw,
                event_callbacks=SubscriptionEventCallbacks(incompatible_qos=on_incompatible, message_lost=on_lost),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )  # fmt: skip
        except RCLError:
            raise  # the middleware's, which may pass
        except (RuntimeError, ParameterException) as error:
            raise ConfigError(f"qos_overrides.{self._node.resolve_topic_name(topic)}: {error}") from None
        self.watch.add(topic, wanted, monitor)
        return subscription

    def _cloud(self, name: str, message: CloudMessage) -> Cloud:
        now = self._last_cloud_s = time.monotonic()
        self._statistics.inputs[name].tick(now)
        stamp_ns = self._last_stamp_ns = ns_from_stamp(message.header.stamp)
        self.watch.stamped(name, stamp_ns)
        return Cloud(message, stamp_ns, now)

    def _on_scan(self, message: CloudMessage) -> None:
        with self.lock:
            self._take(ScanJob(self._cloud("points", message)))

    def _on_cloud(self, side: Side, message: CloudMessage) -> None:
        with self.lock:
            cloud = self._cloud(side, message)
            self.pairer.max_skew_ns = self._parameters.settings.max_skew_ns
            add = self.pairer.add_source if side == "source" else self.pairer.add_target
            self._take_events(add(cloud.stamp_ns, cloud))

    def _on_guess(self, message: PoseWithCovarianceStamped) -> None:
        self._keep(self.guesses, message)

    def _on_odometry(self, message: Odometry) -> None:
        self.odometry_child_frame = message.child_frame_id
        self._keep(self.odometry, message)

    def _on_told(self, message: PoseWithCovarianceStamped) -> None:
        stamp_ns, frame = ns_from_stamp(message.header.stamp), str(message.header.frame_id)
        try:
            pose = pose_from_message(message)
            if stamp_ns and self._last_stamp_ns and abs(stamp_ns - self._last_stamp_ns) > _MOST_APART_NS:
                found = f"{text_from_ns(stamp_ns)} s, and {text_from_ns(self._last_stamp_ns)} s of the last cloud"
                raise InputError(f"initialpose: expected a stamp near those of the clouds, found {found}")
        except InputError as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
        else:
            self.told.add(StampedPose(stamp_ns, frame, pose))

    def _keep(self, poses: PoseBuffer, message: PoseWithCovarianceStamped | Odometry) -> None:
        try:
            poses.add(ns_from_stamp(message.header.stamp), pose_from_message(message))
        except InputError as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _take_events(self, events: list[Event[Cloud]]) -> None:
        for event in events:
            self._take(_job_from_event(event))


def _job_from_event(event: Event[Cloud]) -> Job:
    if isinstance(event, Matched):
        return PairJob(event.source, event.target)
    label = event.item.label
    source, target = (label, None) if event.side == "source" else (None, label)
    return DropJob(source, target, event.reason, event.detail)
