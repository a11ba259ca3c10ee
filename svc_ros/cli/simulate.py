"""`svc_ros simulate`: a drive through a built scene, as a bag with known poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from svc_ros.cli.console import key_value_table, make_output_folder, progress, summary_console

# The names stand here as text, because the modules that know them are slow to import; a test compares.
_SCENES = "street, indoor, corridor, corridor_features"
_SENSORS = "VLP-16, HDL-32E, HDL-64E, OS1-64, OS0-64, OS1-128, RS-M1, MID-40, XTION, UTM-30LX"

OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for bag/ and reference_tum.txt.")]
SceneOption = Annotated[str, typer.Option("--scene", metavar="NAME", help=f"{_SCENES}.")]
SensorOption = Annotated[str, typer.Option("--sensor", metavar="NAME", help=f"{_SENSORS}.")]
ScansOption = Annotated[int, typer.Option("--scans", min=1, metavar="N", help="Scans of the drive.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of the world and of the noise.")]
SpacingOption = Annotated[
    float | None, typer.Option("--spacing", min=0.0, metavar="M", help="Metres between scans; by the scene if absent.")
]
RateOption = Annotated[float, typer.Option("--rate", metavar="HZ", help="Scans a second.")]
MovingOption = Annotated[
    float, typer.Option("--moving-share", min=0.0, max=1.0, metavar="SHARE", help="Share of cars and people that move.")
]
TeleportOption = Annotated[
    int | None,
    typer.Option("--teleport-after", min=0, metavar="K", help="Another world after scan K: no alignment there."),
]
ReturnOption = Annotated[
    bool, typer.Option("--there-and-back", help="Back up from half-way on, along the way that was come.")
]


def simulate(
    out: OutOption,
    scene: SceneOption = "street",
    sensor: SensorOption = "OS1-64",
    scans: ScansOption = 20,
    seed: SeedOption = 0,
    spacing: SpacingOption = None,
    rate: RateOption = 2.0,
    moving_share: MovingOption = 0.15,
    teleport_after: TeleportOption = None,
    there_and_back: ReturnOption = False,
) -> None:
    """Simulate a LiDAR drive and write it as a ROS 2 bag with its reference trajectory."""
    from svc_ros.simulation import DriveConfig, simulate_drive

    config = DriveConfig(
        scene=scene, sensor=sensor, num_scans=scans, spacing_m=spacing, rate_hz=rate, seed=seed,
        moving_share=moving_share, teleport_after=teleport_after, there_and_back=there_and_back,
    )  # fmt: skip
    make_output_folder(out)
    with progress(f"driving through {scene}") as on_progress:
        summary = simulate_drive(out, config, on_progress)
    rows = {
        "bag": summary.bag,
        "reference, poses of the sensor": summary.reference,
        "scans": summary.num_scans,
        "points": summary.num_points,
        "way [m]": summary.length_m,
        "duration [s]": summary.duration_s,
    }
    summary_console(None).print(key_value_table(f"{scene} seen by {sensor}", rows))
