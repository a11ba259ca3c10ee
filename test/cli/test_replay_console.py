"""What a person reads of a replay, and how Ctrl-C becomes a question."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from svc_ros.cli import console
from svc_ros.cli.replay_console import print_summary, replay_progress, stop_request

SUMMARY: dict[str, Any] = {
    "num_scans": 9, "num_decisions": 4, "verdicts": {"accepted": 3, "rejected": 1, "undecided": 0, "dropped": 0},
    "reasons": {"low_overlap": 1, "ok": 3}, "real_time_factor": 2.5,
}  # fmt: skip


def printed(capsys: pytest.CaptureFixture[str], summary: dict[str, Any]) -> list[str]:
    print_summary("bag [/points]", summary, Path("out/x"))
    return capsys.readouterr().out.splitlines()


def test_the_last_line_sums_up(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, SUMMARY)
    assert lines[0] == "bag [/points]"
    assert lines[-1] == "4 decisions on 9 scans (3 accepted, 1 rejected), 2.50 times real time; see out/x"
    assert not any("undecided" in line for line in lines)
    assert printed(capsys, {**SUMMARY, "num_false_accepted": 2})[-1].count("false accepts: 2") == 1
    assert "false loops: 1," in printed(capsys, {**SUMMARY, "false_loops": 1})[-1]
    nothing = {"num_decisions": 0, "verdicts": {}, "reasons": {}, "real_time_factor": None}
    assert printed(capsys, {**SUMMARY, **nothing})[-1] == "0 decisions on 9 scans; see out/x"


def test_where_nothing_is_accepted_the_most_frequent_reason_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    told = {"details": {"low_overlap": "0.02", "too_few_points": "found 0: millimetres?"}}
    refused = {"verdicts": {"accepted": 0, "rejected": 4}, "reasons": {"low_overlap": 1, "too_few_points": 3}}
    lines = printed(capsys, {**SUMMARY, **told, **refused})
    assert lines[-2] == "nothing was accepted; for example too_few_points: found 0: millimetres?"
    assert not any("for example" in line for line in printed(capsys, {**SUMMARY, **told}))


def test_a_report_is_what_to_see(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("")
    print_summary("bag", SUMMARY, tmp_path)
    assert capsys.readouterr().out.splitlines()[-1].endswith(f"see {tmp_path}/report.html")


def test_errors_against_the_reference_are_rows(capsys: pytest.CaptureFixture[str]) -> None:
    errors = {"median": 0.1, "p95": 0.2, "max": 0.3}
    reference = {
        "num_false_accepted": 0, "rotation_error_deg": errors, "translation_error_m": errors,
        "num_accepted_without_reference": 1, "rpe": None,
        "ape": {"translation_m": {"rmse": 0.125}, "rotation_deg": {"rmse": 0.25}},
    }  # fmt: skip
    text = "\n".join(printed(capsys, {**SUMMARY, "reference": reference}))
    assert "APE of the trajectory, rmse [m]" in text
    assert "0.125" in text
    assert "RPE" not in text
    assert "false accepts: 0" in text


def test_progress_tells_rate_and_time_left_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    for is_terminal in (True, False):
        screen = Console(force_terminal=is_terminal, width=120, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
        monkeypatch.setattr(console, "_stderr", screen)
        with replay_progress("replaying") as on_progress:
            for done in range(5):
                on_progress(done, 8)
        text = screen.export_text()
        assert ("replaying" in text and "4/8" in text and "scans/s" in text and "left" in text) == is_terminal
        assert bool(text.strip()) == is_terminal
    assert console.STDOUT == "-"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_asks_and_the_second_one_acts(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    before = signal.getsignal(number)
    with stop_request() as stopped:
        assert not stopped()
        os.kill(os.getpid(), number)
        assert stopped()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert "stopping after this scan" in capsys.readouterr().err
    assert signal.getsignal(number) is before
