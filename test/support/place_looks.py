"""Many different looks of places, made of a few by mixing and turning them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from mini_data import scan_room, sensor_pose

from svc_ros.core.config import preset
from svc_ros.core.registration import prepare
from svc_ros.core.scan import Scan
from svc_ros.pipeline.place import NUM_SECTORS, PlaceLook, look_at_place

STANDS = ((-3.0, 0.0), (0.0, 0.0), (2.5, 0.5), (5.0, -2.0), (-4.0, -2.0), (0.0, 2.5))


@lru_cache(maxsize=1)
def room_counts() -> tuple[np.ndarray, ...]:
    """What a sensor sees around itself from each stand, ring by ring, with the spectrum's own scale."""
    scans = (prepare(Scan(scan_room(sensor_pose(x, y, 0.0))), preset("lidar_indoor")) for x, y in STANDS)
    return tuple(np.fft.irfft(look_at_place(scan).spectrum, n=NUM_SECTORS, axis=1) for scan in scans)


def stacked_looks(looks: Sequence[PlaceLook]) -> np.ndarray:
    """Looks as an index takes them: (N, rings, frequencies)."""
    return np.array([look.spectrum for look in looks], np.complex64)


def mixed_look(rng: np.random.Generator) -> PlaceLook:
    """Two of the room's places in one, each turned by any angle."""
    counts, share = room_counts(), rng.random()
    first, second = (
        np.roll(counts[k], turn, 1)
        for k, turn in zip(rng.integers(len(counts), size=2), rng.integers(NUM_SECTORS, size=2), strict=True)
    )
    mixed = share * first + (1.0 - share) * second
    return PlaceLook(np.fft.rfft(mixed / np.linalg.norm(mixed), axis=1), np.zeros(3))
