"""The one door out of the command line: every error becomes one line on stderr and one exit code."""

from __future__ import annotations

import sys
from typing import Any

import typer
from typer.core import TyperGroup

from svc_ros.core.errors import SvcError

DONE = 0  # whatever the verdict
BAD_INPUT = 2  # bad input or usage
NOT_ACCEPTED = 3  # with --fail-on-reject only
INTERRUPTED = 130  # Ctrl-C, as shells count it

# What typer raises for a command line that it cannot read; its own home differs between versions of typer.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]


def print_error(message: str) -> None:
    """Write one line to stderr, whatever line breaks the message has; never wrapped to the terminal's width."""
    print("error: " + " ".join(message.split()), file=sys.stderr)


class OneDoor(TyperGroup):
    """A command group whose commands may raise: what they raise is answered here and nowhere else.

    An exception that is none of bad input, bad usage or the operating system's refusal is a defect of this package
    and keeps its traceback.
    """

    def main(self, *args: Any, **options: Any) -> Any:
        standalone = options.pop("standalone_mode", True)
        try:
            code = super().main(*args, **{**options, "standalone_mode": False})
        except _UsageError as error:
            print_error(f"{_usage_text(error)} (see {_command_path(error)} --help)")
            code = BAD_INPUT
        code = code if isinstance(code, int) else DONE
        if standalone:
            sys.exit(code)
        return code

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except SvcError as error:
            print_error(str(error))
        except BrokenPipeError:
            raise  # the reader of stdout went away, as `head` does: no message
        except OSError as error:
            print_error(_os_error_text(error))
        except KeyboardInterrupt:
            print_error("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        raise typer.Exit(BAD_INPUT)


def _usage_text(error: Exception) -> str:
    format_message = getattr(error, "format_message", None)
    return str(format_message() if format_message else error).rstrip(".")


def _command_path(error: Exception) -> str:
    context = getattr(error, "ctx", None)
    return str(context.command_path) if context else "svc_ros"


def _os_error_text(error: OSError) -> str:
    cause = error.strerror or type(error).__name__
    return f"{error.filename}: {cause}" if error.filename else str(error) or cause
