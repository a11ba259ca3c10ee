"""Cross spectra of places: equal to plain sums, in any part of the rows."""

from __future__ import annotations

import numpy as np
import pytest
from reference import cross_spectra

from svc_ros.core.kernels.place import correlate


@pytest.mark.parametrize("num", [0, 1, 7, 100])
def test_cross_spectra_equal_plain_sums(num: int) -> None:
    rng = np.random.default_rng(num)
    wanted, *others = (rng.normal(size=(num + 1, 5, 9)) + 1j * rng.normal(size=(num + 1, 5, 9))).astype(np.complex64)
    spectra = np.array(others, np.complex64).reshape(-1, 5, 9)
    weights = rng.random(9).astype(np.float32)
    spectra.flags.writeable = False
    cross, bounds = np.empty((num, 9), np.complex64), np.empty(num, np.float32)
    for part in (slice(0, num // 2), slice(num // 2, num)):
        correlate(part.start, part.stop, wanted, spectra, weights, cross, bounds)
    expected = cross_spectra(wanted, spectra, weights)
    np.testing.assert_allclose(cross, expected[0], atol=1e-5)
    np.testing.assert_allclose(bounds, expected[1], rtol=1e-5)
