"""The hot loop of the cheap look at many poses; no GIL, no state. Twin in test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel
from svc_ros.core.kernels.nearest import find_nearest
from svc_ros.core.kernels.placement import place

_jit = kernel()


@_jit
def count_agreeing(T, points, normals, radius, grid, own_normals, min_cosine, agreeing):  # type: ignore[no-untyped-def]
    """agreeing (H,): points (M, 3) that each pose (H, 4, 4) puts on own surface that faces the same way.

    own_normals (N, 3); grid: the tables of a NearestGrid of the own points.
    """
    shape, spans, starts, blocks, names = grid
    placed, turned, nearest = np.empty_like(points), np.empty_like(points), np.empty(len(points), np.int32)
    for h in range(T.shape[0]):
        place(T[h], points, normals, placed, turned)
        find_nearest(placed, radius, shape, spans, starts, blocks, names, nearest)
        count = 0
        for m in range(points.shape[0]):
            n = nearest[m]
            if n >= 0:
                cosine = 0.0
                for k in range(3):
                    cosine += turned[m, k] * own_normals[n, k]
                count += cosine > min_cosine
        agreeing[h] = count
