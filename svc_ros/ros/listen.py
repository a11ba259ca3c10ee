"""`python -m svc_ros.ros.listen TOPIC --out FOLDER`: what `svc_ros doctor --live` starts, to look at without ROS."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from svc_ros.core.errors import InputError
from svc_ros.io.heard import write_heard
from svc_ros.ros.usage import needs_rclpy


def main(args: list[str] | None = None) -> int:
    """Listen, and write what was heard into the folder. Exit code 2 where that is not possible; one line says why."""
    parser = argparse.ArgumentParser(prog="python -m svc_ros.ros.listen")
    parser.add_argument("topic", help="topic with clouds")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long (default 10)")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="an empty folder")
    options = parser.parse_args(args)
    try:
        import rclpy
        from rclpy.node import Node

        from svc_ros.ros.ear import listen
        from svc_ros.ros.middleware import receiving_transports
    except ImportError as error:
        return _refuse(needs_rclpy("listening", error))
    rclpy.init(args=[])
    with receiving_transports():  # to hear what the node would
        node = Node("svc_ros_doctor", enable_rosout=False, start_parameter_services=False)
    try:
        write_heard(options.out, listen(node, options.topic, options.seconds))
    except InputError as error:
        return _refuse(str(error))
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _refuse(text: str) -> int:
    print(text, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
