"""Hot loops of maps of walls, compiled by numba; no GIL, no state. Twins in test/support/reference_wall_maps.py.

Maps are square and go around: what leaves on one side comes in on the other.
"""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()


@_jit
def walk_rays(ends, reach, step, short, cell, free):  # type: ignore[no-untyped-def]
    """free (S, S): cells about the middle that rays from the origin to ends (N, 2) pass, up to `short` before the end.

    A sample every `step` [m], none beyond `reach` [m].
    """
    half = free.shape[0] // 2
    for i in range(ends.shape[0]):
        length = np.sqrt(ends[i, 0] ** 2 + ends[i, 1] ** 2)
        last = min(length - short, reach)
        at = 0.5 * step
        while at < last:
            x, y = at / length * ends[i, 0], at / length * ends[i, 1]
            free[half + int(np.floor(x / cell + 0.5)), half + int(np.floor(y / cell + 0.5))] = True
            at += step


@_jit
def draw(points, normals, taken, free, cosine, sine, cell, walls, seen):  # type: ignore[no-untyped-def]
    """Turn a map by an angle and fill its two images (S, S) of complex numbers.

    walls: mean of the normals (N, 2) of the points (N, 2) [m] of a cell, x + iy, half of it where one point is alone;
    seen: 1 in taken cells (A, 2), i in free ones (B, 2) that are not taken; both lists are of their middles [m].
    """
    size = walls.shape[0]
    count = np.zeros((size, size), np.float32)
    walls[:], seen[:] = 0.0, 0.0
    for n in range(points.shape[0]):
        i, j = _cell(points[n, 0], points[n, 1], cosine, sine, cell, size)
        x, y = cosine * normals[n, 0] - sine * normals[n, 1], sine * normals[n, 0] + cosine * normals[n, 1]
        walls[i, j] += complex(x, y)
        count[i, j] += 1.0
    for i in range(size):
        for j in range(size):
            if count[i, j] > 0.0:
                walls[i, j] /= max(count[i, j], np.float32(2.0))
    for n in range(free.shape[0]):
        i, j = _cell(free[n, 0], free[n, 1], cosine, sine, cell, size)
        seen[i, j] = 1j
    for n in range(taken.shape[0]):
        i, j = _cell(taken[n, 0], taken[n, 1], cosine, sine, cell, size)
        seen[i, j] = 1.0


@_jit
def _cell(x, y, cosine, sine, cell, size):  # type: ignore[no-untyped-def]
    i = int(np.floor((cosine * x - sine * y) / cell + 0.5))
    j = int(np.floor((sine * x + cosine * y) / cell + 0.5))
    return i % size, j % size


@_jit
def correlate(target, source, quarter, contradiction, spectrum):  # type: ignore[no-untyped-def]
    """spectrum (S, S) of the score of every shift, the source turned by so many quarters of a circle before.

    target, source: (2, S, S), the Fourier transforms of both images; those of the target hold walls against walls and
    taken cells against free ones. An image that is turned by a quarter has a transform that is turned as well.
    """
    size, turn = spectrum.shape[0], np.complex64(1.0)
    for _ in range(quarter):
        turn *= np.complex64(-1j)
    for u in range(size):
        for v in range(size):
            a, b = u, v
            for _ in range(quarter):
                a, b = b, (size - a if a > 0 else 0)
            agreeing = turn * target[0, u, v] * source[0, a, b].conjugate()
            spectrum[u, v] = agreeing - contradiction * (target[1, u, v] * source[1, a, b].conjugate())


@_jit
def find_peaks(score, cells, values):  # type: ignore[no-untyped-def]
    """The highest local maxima of score (S, S) among the eight cells around, best first.

    cells (K, 2), values (K,): -inf where there are fewer than K.
    """
    size, num = score.shape[0], values.shape[0]
    values[:] = -np.inf
    for i in range(size):
        for j in range(size):
            value = score[i, j]
            if value <= values[num - 1] or not _is_highest(score, i, j):
                continue
            k = num - 1
            while k > 0 and values[k - 1] < value:
                values[k], cells[k, 0], cells[k, 1] = values[k - 1], cells[k - 1, 0], cells[k - 1, 1]
                k -= 1
            values[k], cells[k, 0], cells[k, 1] = value, i, j


@_jit
def _is_highest(score, i, j):  # type: ignore[no-untyped-def]
    size = score.shape[0]
    for a in range(-1, 2):
        for b in range(-1, 2):
            if score[(i + a) % size, (j + b) % size] > score[i, j]:
                return False
    return True
