"""The command line called in this process, and what a refusal of it looks like."""

from __future__ import annotations

from typer.testing import CliRunner

from svc_ros.cli.main import app


def run(*arguments: object):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def assert_refused(result, *words: str) -> None:
    """Exit code 2, nothing on stdout, one line on stderr with all of the words."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0]
