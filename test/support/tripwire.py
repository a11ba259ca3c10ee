"""`python tripwire.py NUMBER SIGNAL`: runs the node, and sends it the signal at its NUMBER-th look for a module."""

from __future__ import annotations

import os
import runpy
import sys
from importlib.abc import MetaPathFinder


class Tripwire(MetaPathFinder):
    """Finds nothing; counts from the node's own first import (`signal`), and sends the signal once."""

    def __init__(self, number: int, signum: int) -> None:
        self._left, self._signum, self._is_counting = number, signum, False

    def find_spec(self, name: str, _path: object, _target: object = None) -> None:
        """Called for every module that is not loaded yet."""
        if self._is_counting:
            self._left -= 1
            if self._left == 0:
                os.kill(os.getpid(), self._signum)
        self._is_counting = self._is_counting or name == "svc_ros.ros.node"


if __name__ == "__main__":
    sys.meta_path.insert(0, Tripwire(int(sys.argv[1]), int(sys.argv[2])))
    sys.argv[1:] = []
    runpy.run_module("svc_ros.ros.node", run_name="__main__", alter_sys=True)
