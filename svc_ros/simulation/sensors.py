"""Beam tables of real spinning LiDARs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svc_ros.core.config import unknown_name
from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array, frozen_array


@dataclass(frozen=True, eq=False)
class LidarModel:
    """A spinning LiDAR with one ray for each beam and column.

    elevations_deg: (B,) angle of every beam above the sensor's horizon, highest first; columns: firings a turn;
    min_range_m, max_range_m: returns outside are not reported; range_noise_m: standard deviation of a range;
    dropout_ratio: share of returns that are lost at random, in [0, 1).
    """

    name: str
    elevations_deg: Array
    columns: int
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    dropout_ratio: float

    def __post_init__(self) -> None:
        elevations = frozen_array(self.elevations_deg, np.float64, f"{self.name}.elevations_deg", (None,))
        object.__setattr__(self, "elevations_deg", elevations)
        if self.columns < 1 or not len(elevations):
            raise ConfigError(f"{self.name}: expected at least one beam and one column")
        if not 0.0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(f"{self.name}: expected 0 <= min_range_m < max_range_m, found "
                              f"{self.min_range_m} and {self.max_range_m}")  # fmt: skip
        if self.range_noise_m < 0.0 or not 0.0 <= self.dropout_ratio < 1.0:
            raise ConfigError(f"{self.name}: expected range_noise_m >= 0 and dropout_ratio in [0, 1), found "
                              f"{self.range_noise_m} and {self.dropout_ratio}")  # fmt: skip

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
SENSORS: dict[str, LidarModel] = {model.name: model for model in _MODELS}


def lidar_model(name: str) -> LidarModel:
    """Return the sensor of that name (`os1_64` and `OS1-64` are the same) or raise ConfigError with the nearest one."""
    wanted = name.upper().replace("_", "-")
    if wanted not in SENSORS:
        raise ConfigError(unknown_name("sensor", wanted, list(SENSORS)))
    return SENSORS[wanted]
