"""What ray casting has to know of a sensor."""

from __future__ import annotations

from typing import Protocol

from svc_ros.core import se3
from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array
from svc_ros.simulation.effects import Effects

# T_body_optical (4, 4): x of a body is ahead and z up; z of a camera is ahead, x to the right and y down.
T_BODY_OPTICAL = se3.make_pose([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 0.0])


class SensorModel(Protocol):
    """A range sensor as a list of N rays.

    min_range_m, max_range_m: returns outside are not reported (a depth camera: by depth); range_noise_m: standard
    deviation of a range (depth) close by; dropout_ratio: share of returns that are lost at random, in [0, 1);
    effects: what real sensors add; is_optical: rays, noise and limits are told in a camera's frame, z ahead.
    """

    @property
    def name(self) -> str: ...
    @property
    def min_range_m(self) -> float: ...
    @property
    def max_range_m(self) -> float: ...
    @property
    def range_noise_m(self) -> float: ...
    @property
    def dropout_ratio(self) -> float: ...
    @property
    def effects(self) -> Effects: ...
    @property
    def is_optical(self) -> bool: ...

    @property
    def num_beams(self) -> int:
        """Rows of the beam table, B; ray i belongs to row i % B."""

    def directions(self) -> Array:
        """Unit ray directions (N, 3) in the sensor's frame, in the order of the firings."""

    def firing_times_s(self) -> Array:
        """Times (N,) of the firings after the first one [s]."""


def check_ranges(model: SensorModel) -> None:
    """Raise ConfigError where limits, noise or losses are none that a sensor can have."""
    if not 0.0 <= model.min_range_m < model.max_range_m:
        raise ConfigError(f"{model.name}: expected 0 <= min_range_m < max_range_m, found "
                          f"{model.min_range_m} and {model.max_range_m}")  # fmt: skip
    if model.range_noise_m < 0.0 or not 0.0 <= model.dropout_ratio < 1.0:
        raise ConfigError(f"{model.name}: expected range_noise_m >= 0 and dropout_ratio in [0, 1), found "
                          f"{model.range_noise_m} and {model.dropout_ratio}")  # fmt: skip
