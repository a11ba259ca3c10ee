"""How many threads the kernels take in a process that shares its machine with others that do the same work."""

from __future__ import annotations

import sys

from svc_ros.core import parallel, registration

_LAYER, _ASKED = registration.__name__.rpartition(".")[0], "num_processors"


def use_threads(num_threads: int) -> None:
    """From now on the kernels of this process work on so many threads; results do not depend on it.

    All of the core asks `num_processors`; what it answers is replaced wherever it was imported.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{_LAYER}.") and hasattr(module, _ASKED):
            setattr(module, _ASKED, lambda: num_threads)


def processors_for_each(num_processes: int) -> int:
    """Fair share of this machine's processors, at least one."""
    return max(1, parallel.num_processors() // num_processes)
