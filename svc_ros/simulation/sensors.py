"""Beam tables of real LiDARs, and all sensors by name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svc_ros.core.config import unknown_name
from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array, frozen_array
from svc_ros.simulation.effects import Effects
from svc_ros.simulation.narrow_sensors import DepthCameraModel, RasterModel, RosetteModel
from svc_ros.simulation.sensor_model import SensorModel, check_ranges


@dataclass(frozen=True, eq=False)
class LidarModel:
    """A spinning LiDAR with one ray for each beam and column.

    elevations_deg: (B,) angle of every beam above the sensor's horizon, highest first; columns: firings a turn;
    min_range_m, max_range_m: returns outside are not reported; range_noise_m: standard deviation of a range;
    dropout_ratio: share of returns that are lost at random, in [0, 1); effects: what real sensors add, nothing if not
    told; period_s: time of one turn [s].
    """

    name: str
    elevations_deg: Array
    columns: int
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    dropout_ratio: float
    effects: Effects = field(default_factory=Effects)
    period_s: float = 0.1

    def __post_init__(self) -> None:
        elevations = frozen_array(self.elevations_deg, np.float64, f"{self.name}.elevations_deg", (None,))
        object.__setattr__(self, "elevations_deg", elevations)
        if self.columns < 1 or not len(elevations):
            raise ConfigError(f"{self.name}: expected at least one beam and one column")
        check_ranges(self)

    @property
    def is_optical(self) -> bool:
        return False

    @property
    def num_beams(self) -> int:
        """Beams, B."""
        return len(self.elevations_deg)

    def directions(self) -> Array:
        """Unit ray directions (columns * B, 3) in the sensor's frame (x forward, z up), a column after the other."""
        azimuth = -2.0 * np.pi * np.arange(self.columns) / self.columns  # clockwise from above, as these sensors turn
        elevation = np.radians(self.elevations_deg)
        level = np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
        rays = np.empty((self.columns, self.num_beams, 3))
        rays[..., :2] = level[:, None] * np.cos(elevation)[None, :, None]
        rays[..., 2] = np.sin(elevation)
        return rays.reshape(-1, 3)

    def firing_times_s(self) -> Array:
        """Times (columns * B,) after the first firing [s]; a column fires at once."""
        return np.repeat(np.arange(self.columns) * (self.period_s / self.columns), self.num_beams)


def _fan(top_deg: float, bottom_deg: float, beams: int) -> Array:
    return np.linspace(top_deg, bottom_deg, beams)


# Columns at ten turns a second; fields of view, ranges and accuracies from the makers' data sheets.
_MODELS = (
    LidarModel("VLP-16", _fan(15.0, -15.0, 16), 1800, 0.9, 100.0, 0.02, 0.01),
    LidarModel("HDL-32E", _fan(32 / 3, -92 / 3, 32), 2170, 0.9, 100.0, 0.02, 0.01),
    # Two blocks of lasers: the upper one every third of a degree, the lower one every half.
    LidarModel("HDL-64E", np.r_[_fan(2.0, -25 / 3, 32), _fan(-53 / 6, -73 / 3, 32)], 2083, 0.9, 120.0, 0.02, 0.01),
    LidarModel("OS1-64", _fan(22.5, -22.5, 64), 1024, 0.5, 120.0, 0.03, 0.01),
    LidarModel("OS0-64", _fan(45.0, -45.0, 64), 1024, 0.3, 50.0, 0.03, 0.01),
    LidarModel("OS1-128", _fan(22.5, -22.5, 128), 1024, 0.5, 120.0, 0.03, 0.01),
)
_RASTER_EFFECTS = Effects(noise_per_m=3e-4, footprint_mrad=2.5, mixed_ratio=0.4, mixed_gap_m=2.0)
_ROSETTE_EFFECTS = Effects(noise_per_m=2e-4, footprint_mrad=3.0, mixed_ratio=0.4, mixed_gap_m=2.0)
_CAMERA_EFFECTS = Effects(noise_per_m2=1.5e-3, inverse_depth_step=3e-3, footprint_mrad=3.5, mixed_ratio=0.3)
_TRIPOD_EFFECTS = Effects(noise_per_m=1e-3, footprint_mrad=8.0, mixed_ratio=0.5, mixed_gap_m=4.0)
_OTHERS: tuple[SensorModel, ...] = (
    RasterModel("RS-M1", 126, 600, (120.0, 25.0), 0.5, 150.0, 0.02, 0.01, _RASTER_EFFECTS),
    RosetteModel("MID-40", 150_000, 100_000.0, 38.4, 1.0, 130.0, 0.015, 0.01, _ROSETTE_EFFECTS),
    DepthCameraModel("XTION", 320, 240, (58.0, 45.0), 0.5, 8.0, 0.0015, 0.02, _CAMERA_EFFECTS),
    # A line scanner that a tripod turns once about the vertical; it sees no more than 80 deg down.
    LidarModel("UTM-30LX", _fan(90.0, -80.0, 426), 900, 0.1, 30.0, 0.01, 0.01, _TRIPOD_EFFECTS, 40.0),
)
SENSORS: dict[str, SensorModel] = {model.name: model for model in (*_MODELS, *_OTHERS)}


def sensor_model(name: str) -> SensorModel:
    """Return the sensor of that name (`os1_64` and `OS1-64` are the same) or raise ConfigError with the nearest one."""
    wanted = name.upper().replace("_", "-")
    if wanted not in SENSORS:
        raise ConfigError(unknown_name("sensor", wanted, list(SENSORS)))
    return SENSORS[wanted]


def lidar_model(name: str) -> LidarModel:
    """The same for LiDARs with a beam table; another sensor is refused with ConfigError."""
    model = sensor_model(name)
    if not isinstance(model, LidarModel):
        raise ConfigError(f"{model.name}: expected a LiDAR with a beam table, found {type(model).__name__}")
    return model
