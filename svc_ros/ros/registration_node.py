"""The node: callbacks that only enqueue, one worker that computes, one decision for every pair."""

from __future__ import annotations

import functools
import json
import threading
import time
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import QoSRequestedIncompatibleQoSInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

from svc_ros.core.errors import InputError
from svc_ros.core.result import Reason
from svc_ros.core.scan import Array
from svc_ros.io.stamps import ns_from_stamp
from svc_ros.pipeline.pairing import Event, Matched, Side, StampPairer
from svc_ros.ros.conversions import pose_from_message
from svc_ros.ros.diagnostics import Statistics, statuses
from svc_ros.ros.frames import SensorOrigins
from svc_ros.ros.outputs import Outputs
from svc_ros.ros.parameters import NodeParameters
from svc_ros.ros.registrar import PairRegistrar, warm_up
from svc_ros.ros.worker import Cloud, DropJob, Job, PairJob, Worker

NODE_NAME = "svc_registration"
_KEPT_GUESSES = 16


class RegistrationNode(Node):
    """Pairs two streams of clouds, registers each pair and answers each with exactly one decision.

    Raises ConfigError for parameters that are refused and MissingDependencyError where a parameter needs a package
    that is not there. Call `stop` before the node is destroyed.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(NODE_NAME, **options)
        self._svc = NodeParameters(self)
        settings = self._svc.settings
        self._statistics = Statistics()
        self._pairer: StampPairer[Cloud] = StampPairer(settings.max_skew_ns)
        self._guesses: deque[tuple[int, Array]] = deque(maxlen=_KEPT_GUESSES)
        self._guess_lock = threading.Lock()
        self._enabled = True
        self._last_cloud_s = time.monotonic()
        self._origins = SensorOrigins(self, settings)
        self._registrar = PairRegistrar(
            lambda frame, stamp_ns: self._origins.lookup(self._svc.settings, frame, stamp_ns), self._nearest_guess
        )
        self._outputs = Outputs(self, settings)
        self._worker = Worker(self._process, self._warm_up)
        self._create_inputs()
        self._create_services()
        for text in self._svc.unknown_overrides():
            self.get_logger().warning(text)
        self._worker.start()

    def stop(self, timeout_s: float) -> bool:
        """End the worker after its current pair; False if it was still computing when the time was over."""
        return self._worker.stop(timeout_s)

    # inputs, on the executor's thread

    def _create_inputs(self) -> None:
        for side in ("source", "target"):
            self._subscribe_cloud(side)
        self.create_subscription(PoseWithCovarianceStamped, "initial_guess", self._on_guess, 10)
        # Steady clocks: a timer on simulated time stops when the bag is paused.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.create_timer(0.25, self._give_up_waiting, clock=steady)

    def _subscribe_cloud(self, side: Side) -> None:
        topic = f"{side}_points"

        def on_incompatible(info: QoSRequestedIncompatibleQoSInfo) -> None:
            self._statistics.qos_problems[topic] = f"{info.last_policy_kind} differs from the publisher's"
            self.get_logger().error(f"{topic}: a publisher's QoS does not fit; see qos_overrides./{topic}")

        self.create_subscription(
            PointCloud2,
            topic,
            functools.partial(self._on_cloud, side),
            qos_profile_sensor_data,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=on_incompatible),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _on_cloud(self, side: Side, message: PointCloud2) -> None:
        now = self._last_cloud_s = time.monotonic()
        self._statistics.inputs[side].tick(now)
        stamp_ns = ns_from_stamp(message.header.stamp)
        self._pairer.max_skew_ns = self._svc.settings.max_skew_ns
        add = self._pairer.add_source if side == "source" else self._pairer.add_target
        self._enqueue(add(stamp_ns, Cloud(message, stamp_ns, now)))

    def _on_guess(self, message: PoseWithCovarianceStamped) -> None:
        try:
            guess = pose_from_message(message)
        except InputError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        with self._guess_lock:
            self._guesses.append((ns_from_stamp(message.header.stamp), guess))

    def _give_up_waiting(self) -> None:
        timeout = self._svc.settings.pair_timeout
        if timeout and self._pairer.num_waiting and time.monotonic() - self._last_cloud_s > timeout:
            self._enqueue(self._pairer.flush())

    def _enqueue(self, events: list[Event[Cloud]]) -> None:
        settings = self._svc.settings
        capacity = None if settings.process_every else settings.queue_size
        for event in events:
            self._worker.jobs.put(_job_from_event(event, self._enabled), capacity)

    # the worker's thread

    def _warm_up(self) -> None:
        start = time.monotonic()
        self.get_logger().info("warming up: the first run compiles, which takes a while")
        warm_up(self._svc.config)
        self.get_logger().info(
            f"ready: mode {self._svc.settings.mode}, preset {self._svc.preset_name}, method {self._svc.config.method} "
            f"(warm-up {time.monotonic() - start:.1f} s)"
        )

    def _process(self, job: Job) -> None:
        decision = self._registrar.decide(job, self._svc.config)
        self._statistics.count(decision)
        try:
            self._outputs.publish(decision, self._svc.settings)
        except Exception:
            if self.context.ok():
                raise
            return  # shut down while this pair was computed: nobody listens any more
        self.get_logger().debug(f"{decision.result.verdict.value}: {decision.result.reason.value}")

    def _nearest_guess(self, stamp_ns: int) -> Array | None:
        """The guess for a pair: the one nearest in time, if it is near enough."""
        with self._guess_lock:
            guesses = list(self._guesses)
        nearest = min(guesses, key=lambda item: abs(item[0] - stamp_ns), default=None)
        if nearest is None or abs(nearest[0] - stamp_ns) > self._svc.settings.max_skew_ns:
            return None
        return nearest[1]

    # services and diagnostics, on the executor's thread

    def _create_services(self) -> None:
        self.create_service(Trigger, "~/status", self._on_status)
        self.create_service(SetBool, "~/enable", self._on_enable)
        self.create_service(Trigger, "~/reset", self._on_reset)

    def _flow(self) -> dict[str, Any]:
        pairer = self._pairer
        return {
            "pairing": {
                "matched": pairer.num_matched,
                "unmatched": pairer.num_unmatched,
                "late": pairer.num_late,
                "waiting": pairer.num_waiting,
            },
            "worker": {
                "ready": self._worker.ready.is_set(),
                "enabled": self._enabled,
                "queue": self._worker.jobs.num_waiting,
                "queue_size": self._svc.settings.queue_size,
                "features_reused": self._registrar.num_reused,
            },
        }

    def _on_status(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        status = {
            "mode": self._svc.settings.mode,
            "preset": self._svc.preset_name,
            "method": self._svc.config.method,
            "received": {side: monitor.num_received for side, monitor in self._statistics.inputs.items()},
            **self._flow(),
            **self._statistics.numbers(),
        }
        response.success, response.message = True, json.dumps(status)
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._enabled = bool(request.data)
        if not self._enabled:
            self._worker.jobs.give_up(Reason.INACTIVE, "the node was disabled")
        response.success, response.message = True, "enabled" if self._enabled else "disabled"
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._enqueue(self._pairer.clear())
        self._worker.jobs.give_up(Reason.STALE, "the node was reset")
        with self._guess_lock:
            self._guesses.clear()
        response.success, response.message = True, "pairing, queue and guesses are empty"
        return response

    def _publish_diagnostics(self) -> None:
        message = DiagnosticArray(status=statuses(self._statistics, self._flow(), self._svc.settings.process_every))
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def _job_from_event(event: Event[Cloud], enabled: bool) -> Job:
    if isinstance(event, Matched):
        pair = PairJob(event.source, event.target)
        return pair if enabled else pair.drop(Reason.INACTIVE, "the node is disabled")
    label = event.item.label
    source, target = (label, None) if event.side == "source" else (None, label)
    return DropJob(source, target, event.reason, event.detail)
