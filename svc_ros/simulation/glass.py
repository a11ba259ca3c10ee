"""What panes do with light: most of it goes on, a little comes back, some of it by way of the mirror image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from svc_ros.core.scan import Array
from svc_ros.simulation.tracing import Hits, Tracer, World

_DUST_RATIO = 0.04  # of the beams, that return from the pane wherever they meet it
_HEAD_ON_RATIO, _HEAD_ON_DEG = 0.6, 4.0  # that return from a pane met nearly head on, whose mirror image is the sensor
_MIRRORED_RATIO = 0.08  # that are mirrored where a pane is met head on; more do at a slant (Schlick's approximation)
_PASSED_LIGHT = 0.75  # of the light of a return through a pane: it goes through twice
_OFF_PANE_M = 1e-3


def through_panes(
    panes: Tracer, world: World, paths: tuple[Array, Array], hits: Hits, rng: np.random.Generator
) -> tuple[Hits, NDArray[np.bool_]]:
    """The hits of rays when panes stand in the way, and a mask (N,) of those that ended at or by way of a pane.

    paths: places (N, 3) or (3,) [m] and unit rays (N, 3) in the world; hits: what they meet were there no panes.
    """
    origin, rays = paths
    pane, normals = panes.trace_normals(origin, rays)
    met = pane.distance < hits.distance
    dice = rng.random(len(rays))
    head_on = pane.cosine > np.cos(np.radians(_HEAD_ON_DEG))
    returned = met & (dice < np.where(head_on, _HEAD_ON_RATIO, _DUST_RATIO))
    mirrored = met & ~returned & (1.0 - dice < _MIRRORED_RATIO + (1.0 - _MIRRORED_RATIO) * (1.0 - pane.cosine) ** 5)
    ghosts = _mirror(world, (origin, rays), pane, normals, mirrored)
    passed = Hits(hits.distance, np.where(met, _PASSED_LIGHT, 1.0) * hits.cosine, hits.object_idx)
    from_pane = Hits(pane.distance, np.ones_like(pane.cosine), pane.object_idx)
    return from_pane.where(returned, ghosts.where(mirrored, passed)), returned | mirrored


def _mirror(world: World, paths: tuple[Array, Array], pane: Hits, normals: Array, which: NDArray[np.bool_]) -> Hits:
    """What the chosen rays meet after the pane has mirrored them, at the length of the whole way."""
    places, rays = np.broadcast_to(paths[0], paths[1].shape)[which], paths[1][which]
    normal = normals[which].astype(np.float64)
    onward = rays - 2.0 * np.einsum("ni,ni->n", rays, normal)[:, None] * normal
    way = pane.distance[which]
    seen = world.trace(places + way[:, None] * rays + _OFF_PANE_M * onward, onward)
    count = len(which)
    ghosts = Hits(np.full(count, np.inf), np.zeros(count), np.full(count, -1, np.int64))
    ghosts.distance[which] = way + seen.distance
    ghosts.cosine[which] = seen.cosine
    ghosts.object_idx[which] = seen.object_idx
    return ghosts
