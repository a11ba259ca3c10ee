"""Two scan files on their way into a registration, with errors that name the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from svc_ros.core.config import Config
from svc_ros.core.errors import TooFewPointsError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Scan


def decide_on_files(
    source: Path, target: Path, config: Config, decide: Callable[[Scan, Scan], RegistrationResult]
) -> RegistrationResult:
    """Read both scans and call `decide`; a scan with too few points is reported with its file's name."""
    from svc_ros.io.scan_files import read_scan

    scans = {path: read_scan(path) for path in (source, target)}
    try:
        return decide(scans[source], scans[target])
    except TooFewPointsError:
        for path, scan in scans.items():
            _check_points(path, scan, config)
        raise


def _check_points(path: Path, scan: Scan, config: Config) -> None:
    from svc_ros.core.registration import prepare

    try:
        prepare(scan, config)
    except TooFewPointsError as error:
        raise TooFewPointsError(f"{path}: {error}") from None
