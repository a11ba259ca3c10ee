"""Fixtures that every test file may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from places import PROJECT_ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real scans and bags; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("SVC_ROS_DATA", PROJECT_ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real data not found at {folder} (set SVC_ROS_DATA)")
    return folder


@pytest.fixture
def scripts(monkeypatch) -> None:
    """The scripts in benchmarks/ can be imported; they import each other from their own folder."""
    monkeypatch.syspath_prepend(str(PROJECT_ROOT / "benchmarks"))
