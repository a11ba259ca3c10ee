"""LiDAR scans of built scenes with known poses: the package's own data, nothing to download."""

from svc_ros.simulation.drive import DriveConfig, DriveSummary, drive_scans, simulate_drive
from svc_ros.simulation.scenes import SCENES, build_scene
from svc_ros.simulation.sensors import SENSORS, lidar_model, sensor_model

__all__ = [
    "SCENES",
    "SENSORS",
    "DriveConfig",
    "DriveSummary",
    "build_scene",
    "drive_scans",
    "lidar_model",
    "sensor_model",
    "simulate_drive",
]
