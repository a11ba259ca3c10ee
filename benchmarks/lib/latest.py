"""One JSON file for everything that is measured in time or memory: every script replaces its own sections."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lib.common import _plain, console

NAME = "latest.json"
RUNS = "runs"
_BRIEF = ("date", "commit", "uncommitted", "machine", "packages")


def record(folder: Path, script: str, run: Mapping[str, Any], sections: Mapping[str, Mapping[str, Any]]) -> None:
    """Put sections into `latest.json`; those of other scripts stay.

    Each section says which commit, machine and packages it comes from; the whole run with its configuration stands
    under `runs`.
    """
    path = folder / NAME
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    runs = {**document.pop(RUNS, {}), script: run}
    brief = {"run": script, **{name: run[name] for name in _BRIEF}, "presets": list(run["config"])}
    document |= {name: {**values, **brief} for name, values in sections.items()}
    document = dict(sorted(document.items())) | {RUNS: runs}
    path.write_text(json.dumps(document, indent=1, default=_plain) + "\n", encoding="utf-8")
    console.print(f"wrote {', '.join(sections)} to {path}")
