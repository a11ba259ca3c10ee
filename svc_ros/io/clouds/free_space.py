"""Where an organised cloud says that its sensor looked and met nothing: the directions of points at infinity.

REP 117: +inf is a measurement without a return within range. Which way the beam went is read off the rest of the
cloud: the columns of a spinning sensor are steps in azimuth, each of its rows keeps its own elevation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.scan import Array

_MIN_SHARE = 0.05  # of a row must be returns, for the others' directions to be read off them
_MIN_RETURNS = 10
_SAME_TURN = float(np.radians(5.0))  # columns that span a whole turn but for this are one
_MAX_SPREAD_DEG = 5.0  # of a row's elevations, and of its azimuths about even steps; else it is no row of beams


def free_directions(relative: Array, free: NDArray[np.bool_], height: int, width: int) -> Array | None:
    """Unit directions (F, 3) of the free beams of an organised cloud; None where it tells none.

    relative: (height * width, 3) [m] from the sensor, row by row, not finite where there is no return; free: (height *
    width,) the beams that met nothing. Rows with too few returns, and clouds whose rows are not beams of one elevation
    (depth cameras, sensors on their side, an unknown origin), tell none.
    """
    if height < 2 or not free.any():
        return None
    with np.errstate(invalid="ignore", over="ignore"):  # beyond 1e154 m, where directions still are right
        x, y, z = relative.T.reshape(3, height, width)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
    azimuth[~np.isfinite(relative).all(1).reshape(height, width)] = np.nan
    step = _azimuth_step(azimuth)
    if step is None:
        return None
    rows = zip(azimuth, elevation, free.reshape(height, width), strict=True)
    found = [_row_directions(row_azimuth - step * np.arange(width), row_elevation, wanted, step)
             for row_azimuth, row_elevation, wanted in rows if wanted.any()]  # fmt: skip
    directions = np.concatenate(found)
    return directions if len(directions) else None


def _azimuth_step(azimuth: Array) -> float | None:
    """Azimuth [rad] from column to column: the median over neighbours with a return; None without neighbours."""
    steps = _wrapped(np.diff(azimuth, axis=1))
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if len(steps) else None


def _row_directions(offset: Array, elevation: Array, wanted: NDArray[np.bool_], step: float) -> Array:
    """Directions of a row's wanted columns. offset: (W,) azimuth beyond even steps [rad], NaN where nothing returned.

    Between two returns both angles are interpolated, across the seam too if the row is a whole turn.
    """
    returned = np.flatnonzero(np.isfinite(offset))
    if len(returned) < max(_MIN_RETURNS, _MIN_SHARE * len(offset)):
        return np.zeros((0, 3))
    middle = float(np.angle(np.exp(1j * offset[returned]).sum()))
    beyond, height = _wrapped(offset[returned] - middle), elevation[returned]
    if max(_spread_deg(beyond), _spread_deg(height)) > _MAX_SPREAD_DEG:
        return np.zeros((0, 3))
    whole_turn = abs(abs(step) * len(offset) - 2.0 * np.pi) < _SAME_TURN
    column = np.flatnonzero(wanted)
    if not whole_turn:
        column = column[(column > returned[0]) & (column < returned[-1])]
    period = float(len(offset)) if whole_turn else None
    azimuth = middle + step * column + np.interp(column, returned, beyond, period=period)
    height = np.interp(column, returned, height, period=period)
    level = np.cos(height)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)], axis=1)


def _wrapped(angle: Array) -> Array:
    """Angles [rad] brought to -pi to pi."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _spread_deg(angle: Array) -> float:
    """Spread [deg] of nine tenths of the angles."""
    low, high = np.percentile(angle, (5.0, 95.0))
    return float(np.degrees(high - low))
