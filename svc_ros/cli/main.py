"""The typer app. Commands import what is heavy when they run, so that --help answers at once."""

from __future__ import annotations

from typing import Annotated

import typer

import svc_ros
from svc_ros.cli.calibrate import calibrate
from svc_ros.cli.config import config
from svc_ros.cli.doctor.command import doctor
from svc_ros.cli.evaluate import evaluate
from svc_ros.cli.exit_codes import OneDoor
from svc_ros.cli.map import map as build_map
from svc_ros.cli.register import register
from svc_ros.cli.replay import replay
from svc_ros.cli.simulate import simulate
from svc_ros.cli.verify import verify
from svc_ros.cli.view import view
from svc_ros.core.errors import InputError

app = typer.Typer(
    name="svc_ros",
    cls=OneDoor,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"svc_ros {svc_ros.__version__}")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
]


@app.callback(invoke_without_command=True)
def start(ctx: typer.Context, version: VersionOption = False) -> None:
    """Register LiDAR scans, and know when the answer is wrong.

    Exit codes: 0 done, whatever the verdict; 2 bad input or usage; 3 nothing accepted, with --fail-on-reject.
    """
    if ctx.invoked_subcommand is None:
        typer.echo(ctx.get_help())
        raise InputError("expected a command, found none (see above)")


for command in (register, verify, view, evaluate, calibrate, replay, build_map, simulate, config, doctor):
    app.command(command.__name__)(command)


def main() -> None:
    """Entry point of the console script and of `python -m svc_ros`."""
    app(prog_name="svc_ros")
