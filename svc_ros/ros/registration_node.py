"""The node, for `registration_node` and for your own executor: its life from configuration to shutdown."""

from __future__ import annotations

from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from svc_ros.core.errors import SvcError
from svc_ros.io.config_yaml import NODE_NAME
from svc_ros.ros.parameters import NodeParameters
from svc_ros.ros.safe_events import SafeEventCallbacks
from svc_ros.ros.services import Services
from svc_ros.ros.session import Session

_CLEANUP_S, _FORGOTTEN_S = 60.0, 5.0  # longer than any one job takes, and than most

_SUCCESS, _FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class RegistrationNode(LifecycleNode):
    """A lifecycle node that answers every pair or scan with exactly one decision.

    Options are those of rclpy's Node. With `autostart` (the default) it is active when the constructor returns, and
    what prevents that is raised: ConfigError for refused parameters, InputError for a `graph_file` that cannot be
    written and a `map_folder` that is no map, MissingDependencyError where a parameter needs a package that is not
    there. Call `stop` before the node is destroyed, to say how long a job may still take.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(options.pop("node_name", NODE_NAME), **options)
        self._svc = NodeParameters(self)
        self._session: Session | None = None
        self._offered: Services | None = None
        self._last_offered: Services | None = None
        self._failure: Exception | None = None
        self._is_starting = False
        for text in self._svc.unknown_overrides():
            self.get_logger().warning(text)
        if text := self._svc.differences():
            self.get_logger().info(text)
        # Steady clocks: a timer on simulated time stops when the bag is paused. For good, not for a session: an
        # executor with several threads may still look at a timer that another thread destroys.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self._tell, clock=steady)
        self.create_timer(0.25, self._give_up_waiting, clock=steady)
        if self._svc.settings.autostart:
            self._start()

    def create_publisher(self, *args: Any, **options: Any) -> Publisher:
        """As rclpy's; it may be destroyed while an executor with several threads spins."""
        callbacks = options.pop("event_callbacks", None) or PublisherEventCallbacks()
        return super().create_publisher(*args, event_callbacks=SafeEventCallbacks(callbacks), **options)

    def create_subscription(self, *args: Any, **options: Any) -> Subscription:
        """As rclpy's; it may be destroyed while an executor with several threads spins."""
        callbacks = options.pop("event_callbacks", None) or SubscriptionEventCallbacks()
        return super().create_subscription(*args, event_callbacks=SafeEventCallbacks(callbacks), **options)

    def stop(self, timeout_s: float) -> bool:
        """End the worker after its current job; False if it was still computing when the time was over."""
        return self._session is None or self._session.stop(timeout_s)

    def destroy_node(self) -> None:
        """Stop, if nobody did, and give everything back."""
        self.stop(_FORGOTTEN_S)
        if self._session is not None:
            self._session.close_files()
        super().destroy_node()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create everything and warm up; what goes wrong is said in the log, and the node stays unconfigured."""
        if self._last_offered is not None:
            self._last_offered.give_back()  # they may stay for a moment, and would answer for the new ones
            self._last_offered = None
        try:
            self._session = Session(self, self._svc)
            self._offered = Services(self, self._session)
            for text in self._svc.unmatched_overrides():
                self.get_logger().warning(text)
        except Exception as error:
            self._failure = error
            text = str(error) if isinstance(error, SvcError) else f"{type(error).__name__}: {error}"
            if not self._is_starting:  # otherwise it is raised
                self.get_logger().error(f"cannot be configured: {text}")
            return _FAILURE
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take work from now on."""
        if self._session is not None:
            self._session.is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop what comes from now on as `inactive`."""
        if self._session is not None:
            self._session.is_active = False
            self._session.deactivate("the node was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Finish the current job and forget everything."""
        self._end()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """The same, for good."""
        self._end()
        return super().on_shutdown(state)

    def _start(self) -> None:
        self._is_starting = True
        if self.trigger_configure() != _SUCCESS:
            raise self._failure or SvcError("the node cannot be configured")
        self._is_starting = False
        self.trigger_activate()

    def _tell(self) -> None:
        if (session := self._session) is not None:
            session.tell()

    def _give_up_waiting(self) -> None:
        if (session := self._session) is not None:
            session.inputs.give_up_waiting()

    def _end(self) -> None:
        if self._session is not None:
            self._session.stop(_CLEANUP_S)
            if self._offered is not None:
                self._offered.destroy()
                self._last_offered = self._offered if self._offered.are_left else None
            self._session.destroy()
            self._session = self._offered = None
