"""`svc_ros doctor`: what is installed, what is missing, and whether a bag, or what is sent now, can be used."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from svc_ros.cli.console import check_json_target, summary_console, working, write_json
from svc_ros.cli.doctor.finding import Finding
from svc_ros.cli.exit_codes import BAD_INPUT, print_error
from svc_ros.cli.options import JsonOption, SensorOption, StrictOption

_LISTEN_S = 10.0
_STYLES = {"ok": "green", "warn": "yellow", "error": "bold red"}

BagArgument = Annotated[Path | None, typer.Argument(metavar="[BAG]", help="Check this bag; without it, the machine.")]
TopicOption = Annotated[str | None, typer.Option("--topic", metavar="TOPIC", help="Clouds of this topic only.")]
TrialOption = Annotated[
    bool, typer.Option("--trial/--no-trial", help="Register up to three pairs of neighbouring scans.")
]
LiveOption = Annotated[
    str | None, typer.Option("--live", metavar="TOPIC", help="Listen to this topic, on the domain of this terminal.")
]
SecondsOption = Annotated[
    float | None, typer.Option("--seconds", min=1.0, metavar="S", help=f"How long --live listens; {_LISTEN_S:g} s.")
]


def doctor(
    bag: BagArgument = None,
    topic: TopicOption = None,
    sensor_frame: SensorOption = None,
    live: LiveOption = None,
    seconds: SecondsOption = None,
    trial: TrialOption = True,
    json_target: JsonOption = None,
    strict: StrictOption = False,
) -> None:
    """Say what is installed and missing, or what is odd about a bag or a live topic, which preset fits, what to do.

    Exits with 2 on errors: what keeps every cloud from being used. Warnings leave the exit code at 0.
    """
    for option, value in (("--topic", topic), ("--sensor-frame", sensor_frame)):
        if value is not None and bag is None:
            raise typer.BadParameter(f"{option} belongs to a BAG")
    if strict and bag is None:
        raise typer.BadParameter("--strict belongs to a BAG")
    if live is None and seconds is not None:
        raise typer.BadParameter("--seconds belongs to --live")
    if live is not None and bag is not None:
        raise typer.BadParameter("--live listens to a topic instead of reading a BAG: give one of them")
    check_json_target(json_target)
    with working("looking" if live is None else f"listening to {live}"):
        from svc_ros.cli.doctor.installation import check_bag, check_installation
        from svc_ros.cli.doctor.live import check_topic

        if live is not None:
            findings = check_topic(live, seconds or _LISTEN_S, trial)
        else:
            findings = check_installation() if bag is None else check_bag(bag, topic, trial, sensor_frame, strict)
    num_errors = sum(finding.level == "error" for finding in findings)
    write_json({"num_errors": num_errors, "findings": [dataclasses.asdict(f) for f in findings]}, json_target)
    summary_console(json_target).print(_findings_table(str(live or bag or "this machine"), findings))
    if num_errors:
        failed = ", ".join(finding.name for finding in findings if finding.level == "error")
        print_error(f"{num_errors} of {len(findings)} checks failed: {failed}")
        raise typer.Exit(BAD_INPUT)


def _findings_table(title: str, findings: Sequence[Finding]) -> Table:
    table = Table(title=Text(title), title_justify="left")
    for heading in ("check", "", "found", "what to do"):
        table.add_column(heading, overflow="fold")
    for f in findings:
        table.add_row(Text(f.name), Text(f.level, style=_STYLES[f.level]), Text(f.found), Text(f.advice))
    return table
