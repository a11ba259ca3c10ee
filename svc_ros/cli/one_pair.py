"""What `register` and `verify` do alike: two scan files, one decision, told to programs and to a person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from svc_ros.cli.console import summary_console, working, write_json
from svc_ros.cli.options import Wanted, choose_from
from svc_ros.cli.results import exit_for, show_result
from svc_ros.cli.scans import read_scans
from svc_ros.core.config import Config
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Scan

Judge = Callable[[Scan, Scan, Config], RegistrationResult]


@dataclass(frozen=True)
class OnePair:
    """Two scan files, their columns, the configuration that is asked for, and where the answer goes."""

    source: Path
    target: Path
    wanted: Wanted
    json_target: str | None
    fail_on_reject: bool
    columns: str

    def answer(self, doing: str, judge: Judge) -> None:
        """Let `judge` decide and tell what it says. doing: shown while that takes its time."""
        with working(doing):
            from svc_ros.io.results import result_to_json

            files = read_scans(self.source, self.target, self.columns)
            settings = self.wanted.settle(lambda: choose_from(files.scans))
            result = files.decide(settings.config, lambda s, t: judge(s, t, settings.config))
        names = {"source": str(self.source), "target": str(self.target), **settings.told()}
        write_json(result_to_json(result, **names), self.json_target)
        show_result(summary_console(self.json_target), result, settings.shown())
        exit_for(result.accepted, self.fail_on_reject)
