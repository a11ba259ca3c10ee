"""Pairs of scans about as far apart as one likes, from the positions along a drive."""

from __future__ import annotations

import numpy as np

from svc_ros.core.scan import Array

WINDOW = 100  # scans ahead in which a partner is looked for: 10 s at 10 Hz


def pair_by_distance(positions: Array, distance_m: float = 10.0, window: int = WINDOW) -> list[tuple[int, int]]:
    """Index pairs (earlier, later) of positions (N, 3) [m] in driving order, as the 10 m protocol of KITTI takes them.

    The partner is the last scan before the first one that is farther than `distance_m`; the next pair begins after
    it. A scan without any such partner within the window is passed over, as is one whose very next one is too far.
    """
    pairs, k = [], 0
    while k < len(positions):
        ahead = np.linalg.norm(positions[k : k + window] - positions[k], axis=1)
        far = np.flatnonzero(ahead > distance_m)
        if len(far) == 0:
            k += 1
            continue
        partner = k + int(far[0]) - 1
        if partner > k:
            pairs.append((k, partner))
        k = partner + 1
    return pairs
