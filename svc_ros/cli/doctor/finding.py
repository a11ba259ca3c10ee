"""One line of a check-up, without an opinion about how it is shown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warn", "error"]


@dataclass(frozen=True)
class Finding:
    """What was looked at, how it is, what was found, and what to do about it (empty where nothing is to be done)."""

    name: str
    level: Level
    found: str
    advice: str = ""
