"""What people read: tables, notes and progress bars. Results for programs go through `write_json`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from svc_ros.core.compiling import Compiling, opening, told, watched
from svc_ros.core.errors import InputError
from svc_ros.io.places import check_place

if TYPE_CHECKING:
    from svc_ros.io.bags import Bag

STDOUT = "-"

ProgressCallback = Callable[[int, int], None]

_stderr = Console(stderr=True)
_stdout = Console()


def summary_console(json_target: str | None) -> Console:
    """Where the readable summary goes: stdout, unless the JSON goes there."""
    return _stderr if json_target == STDOUT else _stdout


def note(message: str) -> None:
    """One line for a person, on stderr, not wrapped."""
    print(message, file=sys.stderr)


def warn_of_damage(damage: Iterable[object]) -> None:
    """One line on stderr for each damaged file of a bag."""
    for text in damage:
        note(f"warning: {text}")


@contextmanager
def damage_told(bag: Bag) -> Iterator[None]:
    """Warn of what is known when a bag is open, and at the end of what came to light while it was read."""
    known = [str(damage) for damage in bag.damage]
    warn_of_damage(known)
    yield
    warn_of_damage(text for text in map(str, bag.damage) if text not in known)


@contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """A bar on stderr that vanishes when done, only on a terminal; yields the callback (done, total)."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    with shown(*columns) as bar:
        task = bar.add_task(description, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def working(description: str) -> Iterator[None]:
    """A spinner on stderr for one step of unknown length, only on a terminal."""
    with shown(SpinnerColumn(), TextColumn("{task.description}")) as bar:
        bar.add_task(description, total=None)
        yield


@contextmanager
def shown(*columns: ProgressColumn) -> Iterator[Progress]:
    """A bar on stderr that vanishes when done, only on a terminal; a row of it, or lines, tell what is compiled."""
    bar = Progress(*columns, console=_stderr, transient=True, disable=not _stderr.is_terminal)
    with bar, watched(_CompilingRow(bar)) if _stderr.is_terminal else told(note):
        yield bar


class _CompilingRow:
    """A row of a bar, there while kernels are compiled."""

    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._task: TaskID | None = None

    def __call__(self, state: Compiling) -> None:
        if self._task is None:
            self._bar.console.print(opening(state), soft_wrap=True, markup=False, highlight=False)
            self._task = self._bar.add_task("")
        text = f"compiling the kernels, {state.num_done} of {state.num_expected}"
        self._bar.update(
            self._task, description=text, completed=state.num_done, total=state.num_expected, visible=state.is_busy
        )


def check_json_target(target: str | None) -> None:
    """Refuse a place that cannot be written before the work starts, not after it."""
    if target is None or target == STDOUT:
        return
    check_place("--json", target)


def make_output_folder(path: Path) -> None:
    """Create the folder of --out with its parents, or say why that is not possible."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"--out {path}: expected a folder, found a file in its place") from None
    except OSError as error:
        raise InputError(f"--out {path}: cannot be created: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise InputError(f"--out {path}: no permission to write there")


def write_json(value: Mapping[str, Any], target: str | None) -> None:
    """Write one JSON object to a file or, for `-`, as the only thing on stdout; None writes nothing."""
    if target is None:
        return
    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    if target == STDOUT:
        sys.stdout.write(text)
    else:
        Path(target).write_text(text, encoding="utf-8")


def key_value_table(title: str, rows: Mapping[str, Any]) -> Table:
    """A two-column table; floats with five significant digits, None as a dash."""
    table = Table(title=Text(title) if title else None, title_justify="left", show_header=False)
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for name, value in rows.items():
        table.add_row(Text(name), Text(format_value(value)))  # Text: a unit in brackets is no markup
    return table


def format_value(value: Any) -> str:
    """Text of one value for a table."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)
