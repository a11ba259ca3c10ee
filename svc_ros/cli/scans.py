"""Two scan files on their way into a registration, with errors that name the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from svc_ros.core.config import Config
from svc_ros.core.errors import TooFewPointsError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import PreparedScan, Scan


@dataclass(frozen=True, eq=False)
class ScanFiles:
    """Both scans of a pair and the files they are of, source first."""

    paths: tuple[Path, Path]
    scans: tuple[Scan, Scan]

    def decide(self, config: Config, decide: Callable[[Scan, Scan], RegistrationResult]) -> RegistrationResult:
        """Call `decide` with both; a scan with too few points is reported with its file's name."""
        try:
            return decide(*self.scans)
        except TooFewPointsError:
            self.prepare(config)
            raise

    def prepare(self, config: Config) -> tuple[PreparedScan, PreparedScan]:
        """Both as they are judged; TooFewPointsError names the file."""
        source, target = zip(self.paths, self.scans, strict=True)
        return _prepare(*source, config), _prepare(*target, config)


def read_scans(source: Path, target: Path, columns: str) -> ScanFiles:
    """Read both files, one that is both only once. columns: as `read_scan` takes them."""
    from svc_ros.io.clouds.files import read_scan

    scans = {path: read_scan(path, columns) for path in (source, target)}
    return ScanFiles((source, target), (scans[source], scans[target]))


def _prepare(path: Path, scan: Scan, config: Config) -> PreparedScan:
    from svc_ros.core.registration import prepare

    try:
        return prepare(scan, config)
    except TooFewPointsError as error:
        raise TooFewPointsError(f"{path}: {error}") from None
