"""Which of many places look most like one: all of them compared, at a microsecond each.

A place is compared with every other as `compare_places` does it, in single precision: one product of spectra, ring by
ring, tells how much two looks agree at each frequency, whatever the turn. The sum of these amounts is the most that any
turn can reach, so that the turn itself is looked for only where that could still be among the best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft

from svc_ros.core.kernels import place as place_kernels
from svc_ros.core.parallel import in_parts, on_all_processors
from svc_ros.core.scan import IndexArray
from svc_ros.pipeline.place import NUM_RINGS, NUM_SECTORS, PlaceLook

LOOK_SHAPE = (NUM_RINGS, NUM_SECTORS // 2 + 1)  # of one spectrum
Spectra = NDArray[np.complex64]

_WEIGHTS = np.full(LOOK_SHAPE[1], 2.0 / NUM_SECTORS, np.float32)  # a frequency and its mirror image
_WEIGHTS[[0, -1]] = 1.0 / NUM_SECTORS  # these two have none
_FIRST = 4  # times as many as are wanted are turned at first
_ROUNDING = 1e-5  # of single precision, far above it


class PlaceIndex:
    """Looks of places by number, from 0 on; at most one thread may add, any may search.

    spectra: (N, rings, frequencies) complex64, of the first N places; may be mapped from a file.
    """

    def __init__(self, spectra: Spectra | None = None) -> None:
        self._spectra: Spectra = np.zeros((0, *LOOK_SHAPE), np.complex64) if spectra is None else spectra
        self._num = len(self._spectra)

    def __len__(self) -> int:
        return self._num

    def add(self, look: PlaceLook) -> int:
        """Take the next place; returns its number."""
        if self._num == len(self._spectra):
            larger = np.zeros((max(2 * self._num, 64), *LOOK_SHAPE), np.complex64)
            larger[: self._num] = self._spectra
            self._spectra = larger
        self._spectra[self._num] = look.spectrum
        self._num += 1
        return self._num - 1

    def most_alike(self, look: PlaceLook, most: int, least: float = 0.0) -> list[tuple[int, float]]:
        """At most so many places that look most like this one, and how alike in [0, 1]: best first, then by number.

        least: places that are less alike are left out. Likeness is that of `compare_places` to five digits.
        """
        spectra = self._spectra[: self._num]
        if most < 1 or len(spectra) == 0:
            return []
        cross, bounds = _correlated(look, spectra)
        likeness = np.full(len(spectra), -1.0)
        first = np.argsort(-bounds, kind="stable")[: _FIRST * most]
        likeness[first] = _best_turn(cross, first)
        worst = float(np.sort(likeness[first])[-most]) if len(first) >= most else 0.0
        rest = np.flatnonzero((bounds >= max(worst, least) - _ROUNDING) & (likeness < 0.0))
        likeness[rest] = _best_turn(cross, rest)
        order = np.argsort(-likeness, kind="stable")[:most]
        return [(int(k), float(likeness[k])) for k in order if likeness[k] >= max(least, 0.0)]


def most_alike(look: PlaceLook, looks: Sequence[PlaceLook], most: int, least: float = 0.0) -> list[tuple[int, float]]:
    """The same of a few looks that are searched once."""
    if most < 1 or not looks:
        return []
    return PlaceIndex(np.array([each.spectrum for each in looks], np.complex64)).most_alike(look, most, least)


def _correlated(look: PlaceLook, spectra: Spectra) -> tuple[Spectra, NDArray[np.float32]]:
    """How much each place (N,) agrees with the look at every frequency (N, F), and at most, turned as it may be."""
    cross = np.empty((len(spectra), LOOK_SHAPE[1]), np.complex64)
    bounds = np.empty(len(spectra), np.float32)
    wanted, read_only = look.spectrum.astype(np.complex64), np.asarray(spectra).view()
    read_only.flags.writeable = False  # as those of a file are: one kernel for both

    def correlate(part: slice) -> None:
        place_kernels.correlate(part.start, part.stop, wanted, read_only, _WEIGHTS, cross, bounds)

    on_all_processors(correlate, in_parts(len(spectra)))
    return cross, bounds


def _best_turn(cross: Spectra, numbers: IndexArray) -> NDArray[np.float64]:
    """Likeness (n,) in [0, 1] of those places, each turned to where it agrees most."""
    if len(numbers) == 0:
        return np.zeros(0)
    likeness = irfft(cross[numbers], n=NUM_SECTORS, axis=1).max(axis=1)
    return np.asarray(np.clip(likeness, 0.0, 1.0), np.float64)
