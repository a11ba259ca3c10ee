"""Sensors that look ahead only: solid-state LiDAR, rosette LiDAR, depth camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array
from svc_ros.simulation.effects import Effects
from svc_ros.simulation.sensor_model import check_ranges


@dataclass(frozen=True)
class RasterModel:
    """A solid-state LiDAR: rows and columns at equal angles, x ahead, swept from left to right.

    rows, columns: of the raster; field_of_view_deg: horizontal and vertical; period_s: time of one sweep [s].
    """

    name: str
    rows: int
    columns: int
    field_of_view_deg: tuple[float, float]
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    dropout_ratio: float
    effects: Effects = field(default_factory=Effects)
    period_s: float = 0.1

    def __post_init__(self) -> None:
        check_ranges(self)
        _check_image(self.name, (self.rows, self.columns), self.field_of_view_deg, (360.0, 180.0))

    @property
    def is_optical(self) -> bool:
        return False

    @property
    def num_beams(self) -> int:
        """Rows."""
        return self.rows

    def directions(self) -> Array:
        """Unit ray directions (columns * rows, 3), x ahead, z up, a column after the other from its top."""
        half_width, half_height = 0.5 * np.radians(self.field_of_view_deg)
        azimuth = np.linspace(half_width, -half_width, self.columns)[:, None]
        elevation = np.linspace(half_height, -half_height, self.rows)[None]
        level = np.cos(elevation)
        up = np.broadcast_to(np.sin(elevation), (self.columns, self.rows))
        return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), up], -1).reshape(-1, 3)

    def firing_times_s(self) -> Array:
        """Times (columns * rows,) after the first firing [s]; a column fires at once."""
        return np.repeat(np.arange(self.columns) * (self.period_s / self.columns), self.rows)


@dataclass(frozen=True)
class RosetteModel:
    """A LiDAR behind two turning prisms, whose beam draws a rosette that does not repeat, x ahead.

    num_points: firings of a scan; point_rate_hz: firings a second; field_of_view_deg: width of the round field;
    prisms_hz: turns a second of the two prisms, one against the other; start_s: when the scan begins, and with it where
    in the rosette [s].
    """

    name: str
    num_points: int
    point_rate_hz: float
    field_of_view_deg: float
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    dropout_ratio: float
    effects: Effects = field(default_factory=Effects)
    prisms_hz: tuple[float, float] = (7294.0 / 60.0, -4664.0 / 60.0)
    start_s: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.num_points < 1 or not self.point_rate_hz > 0.0 or not 0.0 < self.field_of_view_deg < 180.0:
            raise ConfigError(f"{self.name}: expected num_points >= 1, point_rate_hz > 0 and field_of_view_deg in "
                              f"(0, 180), found {self}")  # fmt: skip

    @property
    def is_optical(self) -> bool:
        return False

    @property
    def num_beams(self) -> int:
        """One laser."""
        return 1

    def directions(self) -> Array:
        """Unit ray directions (num_points, 3), x ahead and z up."""
        time = self.start_s + self.firing_times_s()
        # Each prism bends the beam by a quarter of the field's width, towards where it has turned to.
        turns = 2.0 * np.pi * np.outer(time, self.prisms_hz)
        bend = 0.25 * np.radians(self.field_of_view_deg)
        y, z = bend * np.cos(turns).sum(axis=1), bend * np.sin(turns).sum(axis=1)
        angle = np.hypot(y, z)
        across = np.sinc(angle / np.pi)
        return np.stack([np.cos(angle), across * y, across * z], -1)

    def firing_times_s(self) -> Array:
        """Times (num_points,) after the first firing [s]."""
        return np.arange(self.num_points) / self.point_rate_hz


@dataclass(frozen=True)
class DepthCameraModel:
    """A depth camera: one ray a pixel of a pinhole image, in the optical frame (z ahead, x right, y down).

    width, height: of the image [pixels]; field_of_view_deg: horizontal and vertical, to the outer pixels' borders;
    min_range_m, max_range_m, range_noise_m: of the depth, z. The whole image is taken at one instant.
    """

    name: str
    width: int
    height: int
    field_of_view_deg: tuple[float, float]
    min_range_m: float
    max_range_m: float
    range_noise_m: float
    dropout_ratio: float
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        check_ranges(self)
        _check_image(self.name, (self.height, self.width), self.field_of_view_deg, (179.0, 179.0))

    @property
    def is_optical(self) -> bool:
        return True

    @property
    def num_beams(self) -> int:
        """Columns of the image."""
        return self.width

    def directions(self) -> Array:
        """Unit ray directions (height * width, 3), z ahead, a row of the image after the other, from the top left."""
        slope = np.tan(0.5 * np.radians(self.field_of_view_deg))
        x = slope[0] * ((np.arange(self.width) + 0.5) / (0.5 * self.width) - 1.0)
        y = slope[1] * ((np.arange(self.height) + 0.5) / (0.5 * self.height) - 1.0)
        rays = np.stack([*np.meshgrid(x, y), np.ones((self.height, self.width))], -1).reshape(-1, 3)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def firing_times_s(self) -> Array:
        """Times (height * width,) [s]: all zero."""
        return np.zeros(self.height * self.width)


def _check_image(name: str, size: tuple[int, int], field_deg: tuple[float, float], most: tuple[float, float]) -> None:
    if min(size) < 1 or not all(0.0 < angle <= limit for angle, limit in zip(field_deg, most, strict=True)):
        raise ConfigError(f"{name}: expected at least one row and one column and a field of view within {most} deg, "
                          f"found {size} and {field_deg}")  # fmt: skip
