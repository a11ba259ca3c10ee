"""Memory of this process."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")


def resident_mb() -> float:
    """Resident set now [MB]; the largest so far where the system does not tell."""
    return _field("VmRSS")


def peak_mb() -> float:
    """Largest resident set so far [MB].

    Linux keeps it for this program alone; getrusage also remembers the program that started it.
    """
    return _field("VmHWM")


def _field(name: str) -> float:
    if _STATUS.exists():
        lines = _STATUS.read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024.0
    unit = 1024.0**2 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
