"""`registration_node`: starts the node, and ends it in good order on Ctrl-C and SIGTERM.

Nothing is imported here that Python has not loaded anyway: signals have to be understood before imports that take
seconds.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable

    from svc_ros.ros.registration_node import RegistrationNode

_JOIN_S = 1.2  # a pair may take longer than anyone wants to wait after Ctrl-C


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop. Exit code 0, or 2 where it cannot start (one line says why)."""
    _on_signals(_leave_now)  # while importing, nothing is open, and an exception could be taken for a failed import
    from svc_ros.ros.usage import USAGE, is_help_wanted, misplaced

    words = sys.argv[1:] if args is None else args
    if is_help_wanted(words):
        print(USAGE, end="")
        return 0
    if problem := misplaced(words):
        return _refuse(problem)
    return _start(args)


def _start(args: list[str] | None) -> int:
    from svc_ros.core.errors import SvcError
    from svc_ros.ros.usage import needs_rclpy

    try:
        import rclpy
    except ImportError as error:
        return _refuse(needs_rclpy("registration_node", error))
    from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
    from rclpy.signals import SignalHandlerOptions

    try:
        from svc_ros.ros.middleware import receiving_transports
        from svc_ros.ros.registration_node import RegistrationNode
    except (SvcError, ImportError) as error:
        return _refuse(str(error))
    stop = _Stop()
    _on_signals(stop)
    try:
        # rclpy's own handlers shut the context down at once: nothing that is still decided could be told, and the log
        # would complain about itself.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except (RCLError, UnknownROSArgsError) as error:
        return _refuse(str(error).replace("\n", " "))
    try:
        with receiving_transports():
            node = RegistrationNode()
    except (SvcError, ImportError) as error:
        rclpy.try_shutdown()
        return _refuse(str(error))
    return _spin(node, stop)


def _spin(node: RegistrationNode, stop: _Stop) -> int:
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not stop.is_wanted:  # Python hears of a signal between two callbacks; a timer is called every 0.25 s
            executor.spin_once()
    except ExternalShutdownException:
        pass
    except RCLError:
        if rclpy.ok():
            raise  # otherwise shut down between the executor's look at that and its waiting
    if not node.stop(_JOIN_S):
        sys.stdout.flush()
        sys.stderr.flush()
        _leave_now()  # nobody needs any more what is computed, and nothing is open but the middleware
    executor.shutdown(timeout_sec=0.2)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


class _Stop:
    """Remembers that a signal came; to raise it as an exception would cut whatever callback runs then."""

    def __init__(self) -> None:
        self.is_wanted = False

    def __call__(self, *_signal: object) -> None:
        self.is_wanted = True


def _on_signals(handle: Callable[[int, FrameType | None], object]) -> None:
    """On Ctrl-C and SIGTERM, call this."""
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, handle)


def _leave_now(*_signal: object) -> NoReturn:
    os._exit(0)


def _refuse(text: str) -> int:
    print(f"registration_node: {text}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
