"""`svc_ros doctor`: what is installed, what is missing, and whether a bag can be used."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def doctor(bag: Annotated[Path | None, typer.Argument(metavar="[BAG]")] = None) -> None:
    """Check the installation, or a bag."""
    from svc_ros.cli.doctor import check_installation

    check_installation()
