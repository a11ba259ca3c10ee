"""Where things are, whichever folder a test stands in."""

from __future__ import annotations

import shutil
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
SUPPORT = TESTS / "support"
PROJECT_ROOT = TESTS.parent
BENCHMARKS = PROJECT_ROOT / "benchmarks"
NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv", "out", "build", "install", "log", "dist", "*_cache", "__pycache__", "*.egg-info", ".hypothesis"
)
