"""Programs of this package as child processes on a middleware domain of their own."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO

_DOMAINS = 101  # higher numbers collide with the ports that Linux gives out
_KEPT = 8
_own: dict[int, tuple[int, int]] = {}  # salt: domain and the file that is locked for it


def own_domain_id(salt: int = 0) -> int:
    """A ROS_DOMAIN_ID that no other process has from here, as long as one is free; another salt gives another one.

    A process keeps the last eight that it asked for, and the same salt has the same one.
    """
    first = os.getpid() * 7 + salt
    if salt in _own:
        return _own[salt][0]
    for step in range(_DOMAINS):
        domain_id = 1 + (first + step) % _DOMAINS
        with contextlib.suppress(OSError):  # another process has it, or the file is somebody else's
            _own[salt] = domain_id, _locked_file(domain_id)
            while len(_own) > _KEPT:
                os.close(_own.pop(next(iter(_own)))[1])
            return domain_id
    return 1 + first % _DOMAINS


def _locked_file(domain_id: int) -> int:
    """A file that no other process can lock as long as this one lives and has it open. Raises OSError."""
    path = Path(tempfile.gettempdir(), f"svc_ros_{os.getuid()}_domain_{domain_id}.lock")
    file = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        raise
    return file


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
