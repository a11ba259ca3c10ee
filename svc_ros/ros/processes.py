"""Programs of this package as child processes on a middleware domain of their own."""

from __future__ import annotations

import fcntl
import functools
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO

_DOMAINS = 101  # higher numbers collide with the ports that Linux gives out
_reservations: list[IO[str]] = []


@functools.cache
def own_domain_id(salt: int = 0) -> int:
    """A ROS_DOMAIN_ID for each salt, which no other process that asks here has until this one ends.

    Processes of one user keep out of each other's way by locks on files in the temporary folder. Where all are taken,
    or none can be locked, it is one that others are unlikely to have.
    """
    wanted = (os.getpid() * 7 + salt) % _DOMAINS
    domains = [1 + (wanted + k) % _DOMAINS for k in range(_DOMAINS)]
    return next(filter(_reserve, domains), domains[0])


def _reserve(domain_id: int) -> bool:
    """Take the domain for this process, unless another one has it."""
    try:
        path = Path(tempfile.gettempdir(), f"svc_ros-{os.getuid()}-domain-{domain_id}.lock")
        file = path.open("a")
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    _reservations.append(file)  # the lock goes with the file
    return True


def local_environment(domain_id: int) -> dict[str, str]:
    """This process's environment, on `domain_id` and with discovery that stays on this machine."""
    return {**os.environ, "ROS_DOMAIN_ID": str(domain_id), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


class ChildProcess:
    """`python -m MODULE ARGS` in a process group of its own; leaving the context ends it, whatever happened.

    Its output, both streams, goes to the file `log`.
    """

    def __init__(self, module: str, args: list[str], environment: dict[str, str], log: Path) -> None:
        self.log = log
        self._command = [sys.executable, "-m", module, *args]
        self._environment = environment
        self._file: IO[bytes] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> ChildProcess:
        self._file = self.log.open("wb")
        self._process = subprocess.Popen(
            self._command, env=self._environment, stdout=self._file, stderr=subprocess.STDOUT, start_new_session=True
        )
        return self

    def __exit__(self, *_exception: object) -> None:
        self.stop()
        if self._file is not None:
            self._file.close()

    @property
    def pid(self) -> int | None:
        """Its number, None before it was started."""
        return None if self._process is None else self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, None while it runs."""
        return None if self._process is None else self._process.poll()

    def interrupt(self, signum: int = signal.SIGINT) -> None:
        """Send a signal; Ctrl-C unless told otherwise."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signum)

    def wait(self, timeout_s: float) -> int | None:
        """Wait for its end; None if it still runs then."""
        if self._process is None:
            return None
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, timeout_s: float = 3.0) -> int | None:
        """Ask it to end, and end it if it does not; returns the exit code."""
        self.interrupt()
        if self.wait(timeout_s) is None and self._process is not None:
            self._process.kill()
            self._process.wait()
        return self.exit_code

    def output(self) -> str:
        """What it has said so far."""
        return self.log.read_text("utf-8", "replace")
