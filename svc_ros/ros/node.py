"""`registration_node`: starts the node, and ends it in good order on Ctrl-C and SIGTERM."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

from svc_ros.core.errors import SvcError

if TYPE_CHECKING:
    from svc_ros.ros.registration_node import RegistrationNode

_NO_RCLPY = (
    "registration_node needs rclpy: pip install 'svc_ros[ros]' on a machine without ROS, "
    "or apt install ros-jazzy-rclpy and source /opt/ros/jazzy/setup.bash"
)
_JOIN_S = 1.2  # a pair may take longer than anyone wants to wait after Ctrl-C


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop. Exit code 0, or 2 where it cannot start (one line says why)."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        return _start(args)
    except KeyboardInterrupt:  # while starting: nothing is running yet
        return 0


def _start(args: list[str] | None) -> int:
    try:
        import rclpy
    except ImportError as error:
        return _refuse(f"{_NO_RCLPY} ({error})")
    from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError

    try:
        rclpy.init(args=args)
    except (RCLError, UnknownROSArgsError) as error:
        return _refuse(str(error).replace("\n", " "))
    try:
        from svc_ros.ros.middleware import receiving_transports
        from svc_ros.ros.registration_node import RegistrationNode

        with receiving_transports():
            node = RegistrationNode()
    except (SvcError, ImportError) as error:
        rclpy.try_shutdown()
        return _refuse(str(error))
    return _spin(node)


def _spin(node: RegistrationNode) -> int:
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():
            raise  # otherwise shut down between the executor's look at that and its waiting
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not cut the tidying short
    if not node.stop(_JOIN_S):
        _leave_now()
    executor.shutdown(timeout_sec=0.2)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


def _leave_now() -> NoReturn:
    """Exit without waiting for a computation that nobody needs any more; nothing is left open but the middleware."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _interrupt(_signum: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _refuse(text: str) -> int:
    print(f"registration_node: {text}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
