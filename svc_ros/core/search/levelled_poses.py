"""Poses of two scans that both see the ground: every turn about the vertical and every shift is tried.

What stays of six degrees of freedom are a turn and a shift, few enough to try them all on maps seen from above. A shift
is scored by the walls that agree, the way they face included, less the walls that stand where the other sensor looked
across: the sight view constraint on a map (paper, Theorem 1). The scores of all shifts of one turn are a correlation,
and that is a product of Fourier transforms. It needs no descriptors, so that it finds what lies far apart, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from svc_ros.core.kernels import wall_map as wall_map_kernels
from svc_ros.core.parallel import on_all_processors
from svc_ros.core.scan import Array, PreparedScan
from svc_ros.core.scans.levelling import Level
from svc_ros.core.scans.wall_map import Raster, WallMap, choose_raster, wall_map
from svc_ros.core.se3 import invert, make_pose
from svc_ros.core.search.shortlist import select_apart

_TURNS = 120  # of 3 deg, a multiple of 4
_PEAKS = 12  # of one turn
_CONTRADICTION = 0.1  # a wall where the other sensor looked across counts so much of one that agrees
_BLUR_CELLS = 0.6
_NEAR_TURNS, _NEAR_CELLS = 2, 2  # peaks that are no farther apart are one


def find_levelled_poses(source: PreparedScan, target: PreparedScan, levels: Sequence[Level], limit: int) -> Array:
    """At most `limit` distinct poses T_target_source (H, 4, 4), best first, of scans that stand so (source, target)."""
    raster = choose_raster(source, target)
    ways = [(source, levels[0].T_level_scan), (target, levels[1].T_level_scan)]
    maps = on_all_processors(lambda way: wall_map(*way, raster), ways)
    peaks = _distinct(score_all(maps[0], maps[1], raster), limit, raster)
    return np.array([_pose(maps[0], maps[1], peak, raster) for peak in peaks]).reshape(-1, 4, 4)


def score_all(source: WallMap, target: WallMap, raster: Raster) -> Array:
    """The best shifts of every turn: rows of score, turn and the shift in cells along x and y."""
    transformed = _transform_target(target, raster)

    def score(turn: int) -> Array:
        images = scipy.fft.fft2(_draw(source, turn, raster), overwrite_x=True)
        spectrum, found = np.empty(images.shape[1:], np.complex64), []
        for quarter in range(4):
            wall_map_kernels.correlate(transformed, images, quarter, np.float32(_CONTRADICTION), spectrum)
            found.append(_peaks(scipy.fft.ifft2(spectrum).real, turn + quarter * _TURNS // 4))
        return np.concatenate(found)

    return np.concatenate(on_all_processors(score, range(_TURNS // 4)))


def _transform_target(target: WallMap, raster: Raster) -> NDArray[np.complex64]:
    """(2, S, S): walls, and cells so that taken ones meet the source's free ones and the other way round; blurred."""
    frequency = scipy.fft.fftfreq(raster.size)
    blur = np.exp(-2.0 * (np.pi * _BLUR_CELLS) ** 2 * (frequency[:, None] ** 2 + frequency**2)).astype(np.float32)
    images = _draw(target, 0, raster)
    images[1] = 1j * images[1].conj()
    return np.asarray(scipy.fft.fft2(images, overwrite_x=True) * blur)


def _draw(drawn: WallMap, turn: int, raster: Raster) -> NDArray[np.complex64]:
    angle, images = 2.0 * np.pi * turn / _TURNS, np.empty((2, raster.size, raster.size), np.complex64)
    wall_map_kernels.draw(
        drawn.walls, drawn.normals, drawn.taken, drawn.free, np.cos(angle), np.sin(angle), raster.cell_m, *images
    )
    return images


def _peaks(score: NDArray[np.float32], turn: int) -> Array:
    cells, values = np.zeros((_PEAKS, 2), np.int64), np.empty(_PEAKS)
    wall_map_kernels.find_peaks(score, cells, values)
    shift = (cells + len(score) // 2) % len(score) - len(score) // 2
    return np.column_stack((values, np.full(_PEAKS, turn), shift))


def _distinct(peaks: Array, limit: int, raster: Raster) -> Array:
    """The best rows, none near one that stands before it."""
    peaks = peaks[np.argsort(-peaks[:, 0], kind="stable")]
    around = np.array([_TURNS, raster.size, raster.size])

    def near(k: int) -> NDArray[np.bool_]:
        apart = np.abs(peaks[:, 1:] - peaks[k, 1:])
        return np.asarray((np.minimum(apart, around - apart) <= (_NEAR_TURNS, _NEAR_CELLS, _NEAR_CELLS)).all(1))

    return peaks[select_apart(np.isfinite(peaks[:, 0]), near, limit)]


def _pose(source: WallMap, target: WallMap, peak: Array, raster: Raster) -> Array:
    angle = 2.0 * np.pi * peak[1] / _TURNS
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = make_pose([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], [*(peak[2:] * raster.cell_m), 0.0])
    return np.asarray(invert(target.T_level_scan) @ turned @ source.T_level_scan)
