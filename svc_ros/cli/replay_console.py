"""What a person sees of a replay: progress, a table, a line that sums it up."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from svc_ros.cli.console import ProgressCallback, key_value_table, note, shown, summary_console


class _RateColumn(ProgressColumn):
    """Scans a second."""

    def render(self, task: Task) -> Text:
        return Text("" if task.speed is None else f"{task.speed:.1f} scans/s", "cyan")


@contextmanager
def replay_progress(description: str) -> Iterator[ProgressCallback]:
    """A bar on stderr with rate and time left, only on a terminal; yields the callback (done, total)."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _RateColumn())
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    with shown(*columns, *times) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def stop_request() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C (or SIGTERM) into a question that is asked between scans; the second one acts at once."""
    requests: list[int] = []

    def ask(signum: int, _: FrameType | None) -> None:
        requests.append(signum)
        if len(requests) > 1:
            raise KeyboardInterrupt
        note("stopping after this scan (again: at once)")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(requests)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_summary(title: str, summary: Mapping[str, Any], out: Path) -> None:
    """The table of one bag, or of several, and the line that sums it up."""
    console = summary_console(None)
    console.print(Text(title, "bold"), soft_wrap=True)
    console.print(key_value_table("", _rows(summary)))
    if why := _why_nothing(summary):
        console.print(Text(why), soft_wrap=True)
    console.print(Text(_line(summary, out)), soft_wrap=True)


def _why_nothing(summary: Mapping[str, Any]) -> str:
    """The detail of the most frequent reason, where not one pose was accepted; of several bags each tells its own."""
    details = summary.get("details")
    if not details or summary["verdicts"].get("accepted"):
        return ""
    most = max(details, key=lambda reason: summary["reasons"][reason])
    return f"nothing was accepted; for example {most}: {details[most]}"


def _rows(summary: Mapping[str, Any]) -> dict[str, Any]:
    rows: dict[str, Any] = {"scans": summary["num_scans"], "decisions": summary["num_decisions"]}
    rows |= {name: count for name, count in summary["verdicts"].items() if count}
    rows |= {f"reason {name}": count for name, count in summary["reasons"].items()}
    rows["times as fast as recorded"] = summary["real_time_factor"]
    if note := summary.get("optimized", {}).get("note"):
        rows["no optimized trajectory"] = note
    reference = summary.get("reference")
    if reference is None:
        return rows
    rows["accepted, largest rotation error [deg]"] = reference["rotation_error_deg"]["max"]
    rows["accepted, largest translation error [m]"] = reference["translation_error_m"]["max"]
    rows["accepted, without a reference"] = reference["num_accepted_without_reference"]
    for name in ("ape", "rpe"):
        errors = reference[name]
        if errors is not None:
            rows[f"{name.upper()} of the trajectory, rmse [m]"] = errors["translation_m"]["rmse"]
            rows[f"{name.upper()} of the trajectory, rmse [deg]"] = errors["rotation_deg"]["rmse"]
        optimized = reference.get("optimized", {}).get(name)
        if optimized is not None:
            rows[f"{name.upper()} after the loops, rmse [m]"] = optimized["translation_m"]["rmse"]
            rows[f"{name.upper()} after the loops, rmse [deg]"] = optimized["rotation_deg"]["rmse"]
    return rows


def _line(summary: Mapping[str, Any], out: Path) -> str:
    """One line: how many decisions of each verdict, what was false, how fast, and where the rest is."""
    verdicts = ", ".join(f"{count} {name}" for name, count in summary["verdicts"].items() if count)
    decided = f"{summary['num_decisions']} decisions on {summary['num_scans']} scans"
    parts = [f"{decided} ({verdicts})" if verdicts else decided]
    if "false_loops" in summary:
        parts.append(f"false loops: {summary['false_loops']}")
    elif (false := summary.get("reference", summary).get("num_false_accepted")) is not None:
        parts.append(f"false accepts: {false}")
    if summary["real_time_factor"] is not None:
        parts.append(f"{summary['real_time_factor']:.2f} times real time")
    report = out / "report.html"
    return f"{', '.join(parts)}; see {report if report.is_file() else out}"
