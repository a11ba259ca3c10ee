"""`python -m svc_ros.ros.compile_kernels`: compiles now what the first start would compile, as in an image's build."""

from __future__ import annotations

import sys
from functools import partial

from svc_ros.core.compiling import told
from svc_ros.core.config import preset


def main() -> int:
    """Say on stderr how far it is; nothing where all is compiled. Needs no rclpy."""
    with told(partial(print, file=sys.stderr, flush=True)):
        from svc_ros.ros.streams.registrar import warm_up

        warm_up(preset("lidar_outdoor"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
