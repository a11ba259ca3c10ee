"""The hot loop of place search; no GIL, no state. Twin in test/support/reference.py."""

from __future__ import annotations

import numpy as np

from svc_ros.core.compiling import kernel

_jit = kernel()


@_jit
def correlate(begin, end, wanted, spectra, weights, cross, bounds):  # type: ignore[no-untyped-def]
    """cross (N, F): sum over rings of conj(wanted) spectra, of rows `begin` to `end`; bounds (N,): of its transform.

    wanted (R, F), spectra (N, R, F): complex64; weights (F,): by how much each frequency counts in the inverse
    transform, whose values are nowhere above the bound.
    """
    num_rings, num_frequencies = wanted.shape
    for i in range(begin, end):
        for f in range(num_frequencies):
            cross[i, f] = 0.0
        for r in range(num_rings):
            for f in range(num_frequencies):
                cross[i, f] += np.conj(wanted[r, f]) * spectra[i, r, f]
        bound = np.float32(0.0)
        for f in range(num_frequencies):
            bound += weights[f] * np.abs(cross[i, f])
        bounds[i] = bound
