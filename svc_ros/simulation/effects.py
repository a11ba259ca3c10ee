"""What a real sensor adds to ideal rays: noise that grows with range, steps of disparity, beams with a width."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from svc_ros.core.errors import ConfigError
from svc_ros.core.scan import Array

_AROUND = np.radians([0.0, 180.0, 90.0, 270.0])  # rays at the rim of a beam, in opposite pairs
_EDGE_M = 0.08  # a bend of the surface within one beam that counts as an edge
_MEASURED_SHARE = (0.05, 0.95)  # of the way from the foreground to the background, where a mixed return lies


@dataclass(frozen=True)
class Effects:
    """What is added to rays; nothing by default.

    noise_per_m, noise_per_m2: growth of the range noise, sigma = range_noise_m + noise_per_m * r + noise_per_m2 * r^2
    [1, 1/m]; inverse_depth_step: step of what is measured, 1 / depth [1/m], 0 for none; footprint_mrad: width of a beam
    [mrad], 0 for a ray; mixed_ratio: share of the beams across a depth edge that return from between its sides, in
    [0, 1]; mixed_gap_m: sides farther apart than this give two returns that do not mix [m].
    """

    noise_per_m: float = 0.0
    noise_per_m2: float = 0.0
    inverse_depth_step: float = 0.0
    footprint_mrad: float = 0.0
    mixed_ratio: float = 0.5
    mixed_gap_m: float = np.inf

    def __post_init__(self) -> None:
        sizes = (self.noise_per_m, self.noise_per_m2, self.inverse_depth_step, self.footprint_mrad, self.mixed_gap_m)
        if min(sizes) < 0.0 or not 0.0 <= self.mixed_ratio <= 1.0:
            raise ConfigError(f"effects: expected sizes >= 0 and mixed_ratio in [0, 1], found {self}")

    @property
    def noise_grows(self) -> bool:
        """True if the noise depends on the range."""
        return self.noise_per_m > 0.0 or self.noise_per_m2 > 0.0

    @property
    def mixes(self) -> bool:
        """True if beams have a width that shows."""
        return self.footprint_mrad > 0.0 and self.mixed_ratio > 0.0

    def sigma_m(self, base_m: float, depth: Array, reach_m: float) -> float | Array:
        """Standard deviation of a range or depth (N,) [m]; beyond `reach_m` it grows no further."""
        if not self.noise_grows:
            return base_m
        near = np.clip(depth, 0.0, reach_m)
        return np.asarray(base_m + self.noise_per_m * near + self.noise_per_m2 * near**2)

    def stepped(self, depth: Array) -> Array:
        """Depths (N,) [m] as the steps of 1 / depth allow; what lies beyond the last step is inf."""
        if self.inverse_depth_step == 0.0:
            return depth
        steps = np.round(1.0 / (np.maximum(depth, 1e-6) * self.inverse_depth_step))
        return np.divide(1.0, steps * self.inverse_depth_step, out=np.full_like(depth, np.inf), where=steps > 0)


def mixed_distances(
    effects: Effects, rays: Array, distance: Array, trace: Callable[[Array], Array], rng: np.random.Generator
) -> Array:
    """Distances (N,) [m] of beams with a width: across a depth edge, some lie between its sides.

    rays: (N, 3) unit, the middles of the beams, which meet something at `distance` (N,) [m], inf for nothing;
    trace: distances [m] of other rays (N, 3) from the same places.
    """
    rim = np.stack([trace(ray) for ray in _rim_rays(rays, effects.footprint_mrad)])
    met = np.isfinite(distance)
    middle = np.where(met, distance, 1.0)
    sides = np.concatenate([np.where(met, distance, np.inf)[None], rim])
    near = sides.min(axis=0)
    far = np.where(np.isfinite(sides), sides, -np.inf).max(axis=0)
    # On a plane 1 / range is linear in the direction, so that a slant, however steep, is no edge.
    inverse = np.divide(1.0, rim, out=np.zeros_like(rim), where=rim > 0.0)
    bend = np.abs(inverse[0::2] + inverse[1::2] - 2.0 / middle).max(axis=0) * middle**2
    gap = np.subtract(far, near, out=np.zeros_like(near), where=np.isfinite(near))
    edge = met & (bend > _EDGE_M) & (gap > _EDGE_M) & (gap <= effects.mixed_gap_m)
    chosen = edge & (rng.random(len(rays)) < effects.mixed_ratio)
    share = rng.uniform(*_MEASURED_SHARE, len(rays))
    return np.where(chosen, near + share * np.where(chosen, gap, 0.0), distance)


def _rim_rays(rays: Array, footprint_mrad: float) -> list[Array]:
    """Four rays (N, 3), unit, at the rim of each beam."""
    least = np.abs(rays).argmin(axis=1)
    across = np.cross(rays, np.eye(3)[least])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(rays, across)
    radius = 0.5e-3 * footprint_mrad
    rim = [rays + radius * (np.cos(a) * across + np.sin(a) * other) for a in _AROUND]
    return [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rim]
