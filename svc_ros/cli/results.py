"""How one decision is shown to a person, and how its exit code follows from it."""

from __future__ import annotations

from typing import Any

import typer
from rich.console import Console, Group
from rich.text import Text

from svc_ros.cli.console import key_value_table
from svc_ros.cli.exit_codes import NOT_ACCEPTED
from svc_ros.core.result import RegistrationResult, Verdict

_STYLES = {Verdict.ACCEPTED: "bold green", Verdict.UNDECIDED: "bold yellow"}


def show_result(console: Console, result: RegistrationResult, preset: str) -> None:
    """Print verdict, reason, pose, evidence and times of one pair, and the preset that it was decided with."""
    verdict = (result.verdict.value.upper(), _STYLES.get(result.verdict, "bold red"))
    headline = Text.assemble(verdict, f"  {result.reason.value}  {result.detail}")
    parts: list[Any] = [headline]
    if result.best_candidate is not None:
        name = "T_target_source" if result.accepted else "best candidate, not accepted"
        parts.append(Text(f"{name}\n{_matrix_text(result.best_candidate)}"))
    parts.append(Text(f"preset {preset}"))
    if result.probability is not None:
        parts.append(Text(f"probability that it is right: {result.probability:.3f}"))
    if result.evidence is not None:
        parts.append(key_value_table("evidence", result.evidence.numbers()))
    parts.append(key_value_table("counts", result.counts))
    parts.append(key_value_table("time [ms]", {k: round(v, 1) for k, v in result.time_ms.items()}))
    console.print(Group(*parts), soft_wrap=True)


def exit_for(accepted: bool, fail_on_reject: bool) -> None:
    """Leave with the code of --fail-on-reject where nothing was accepted."""
    if fail_on_reject and not accepted:
        raise typer.Exit(NOT_ACCEPTED)


def _matrix_text(T: Any) -> str:
    return "\n".join("  ".join(f"{value: 11.6f}" for value in row) for row in T)
