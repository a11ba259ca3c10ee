"""Raw points that a range image has to cope with, and the directions of sensors that look in rings and rasters."""

from __future__ import annotations

import numpy as np

from svc_ros.core.kernels import range_image as range_image_kernels
from svc_ros.core.range_image import Tables


def directions_of(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3)."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def raster(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    """Every azimuth with every elevation, unit (N, 3)."""
    return directions_of(*(values.ravel() for values in np.meshgrid(azimuth_deg, elevation_deg)))


def ring(elevation_deg: float, range_m: float = 8.0) -> np.ndarray:
    return range_m * raster(np.arange(-180.0, 180.0, 0.2), np.array([elevation_deg]))


def depth_camera() -> np.ndarray:
    """It looks along z: the pole is in the middle of its view."""
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(-0.55, 0.55, 120), np.linspace(-0.42, 0.42, 90)))
    return (2.0 + 0.5 * x)[:, None] * np.column_stack([x, y, np.ones_like(x)])


def cases() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    everywhere = rng.normal(size=(4000, 3)) * rng.uniform(0.5, 20, (4000, 1))
    seam = directions_of(180.0 + rng.uniform(-1, 1, 400), rng.uniform(-3, 3, 400)) * rng.uniform(2, 9, (400, 1))
    axes = np.concatenate([np.eye(3), -np.eye(3)]) * 5.0
    poles = np.vstack([0.01 * rng.normal(size=(400, 3)) + [0, 0, s] for s in (3.0, -3.0)] + [axes[[2, 5]]])
    return {
        "everywhere": everywhere, "seam": seam,
        "on_the_seam": np.array([[-5.0, 0, 0], [-5.0, -0.0, 0], [-5, 1e-14, 0]]),
        "axes": axes, "poles": poles, "none": np.zeros((0, 3)), "one": np.array([[3.0, -4.0, 1.0]]),
        "at_the_sensor": np.zeros((5, 3)),
        "one_ring": ring(-7.0), "two_rings": np.vstack([ring(-7.0), ring(-6.5, 9.0)]),
        "one_cell": np.array([6.0, 0.01, 0.01]) * rng.uniform(0.2, 3.0, (300, 1)),
        "nearer_than_allowed": 0.05 * everywhere[:500] / np.linalg.norm(everywhere[:500], axis=1)[:, None],
        "depth_camera": depth_camera(), "far": 1e9 * everywhere[:1000], "beyond_float32": 1e60 * everywhere[:1000],
        "spinning": 10.0 * raster(np.arange(-180, 180, 0.4), np.arange(-15, 16, 2.0)),
    }  # fmt: skip


CASES = cases()
MIN_RANGE = 0.5


def cells_of(points: np.ndarray, tables: Tables) -> tuple[np.ndarray, np.ndarray]:
    """Cell and length of each point (N, 3) that is not at 0, 0, 0."""
    found = [range_image_kernels.find_cell(x, y, z, *tables) for x, y, z in points]
    return np.array([cell for cell, _ in found], int), np.array([length for _, length in found])


def seen(points: np.ndarray, min_range: float = MIN_RANGE) -> np.ndarray:
    return points[np.linalg.norm(points, axis=1) > min_range]
