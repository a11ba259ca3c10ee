"""`svc_ros simulate`: a drive through a built scene, as a bag with known poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def simulate(out: Annotated[Path, typer.Option("--out", metavar="DIR")]) -> None:
    """Simulate a LiDAR drive and write it as a ROS 2 bag with its reference trajectory."""
    from svc_ros.simulation import simulate_drive

    simulate_drive(out)
