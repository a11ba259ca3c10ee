"""Memory of a process."""

from __future__ import annotations

import resource
import sys
from pathlib import Path


def resident_mb(pid: int | None = None) -> float:
    """Resident set now [MB], of this process or of another one; where the system does not tell, this one's largest."""
    return _field("VmRSS", pid)


def peak_mb() -> float:
    """Largest resident set so far [MB].

    Linux keeps it for this program alone; getrusage also remembers the program that started it.
    """
    return _field("VmHWM")


def _field(name: str, pid: int | None = None) -> float:
    status = Path("/proc") / ("self" if pid is None else str(pid)) / "status"
    if status.exists():
        lines = status.read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:")) / 1024.0
    unit = 1024.0**2 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
