"""Checks of stamps: their order, their gaps, and the clock that those of a bag come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from svc_ros.cli.doctor.finding import Finding
from svc_ros.io.stamps import text_from_ns

_GAP_FACTOR = 2.5  # times the median step, beyond which scans are missing
_CLOCK_S = 1.0  # header and bag time farther apart than this come of different clocks


def check_stamps(stamps_ns: Sequence[int]) -> list[Finding]:
    """Look at the header stamps of a topic [ns], in the order in which clouds came."""
    if not any(stamps_ns):
        return [Finding("stamps", "error", "all zero", "the driver must stamp its clouds; pairs are made by stamp")]
    if len(stamps_ns) > 1 and len(set(stamps_ns)) == 1:
        found = f"all {text_from_ns(stamps_ns[0])} s"
        return [Finding("stamps", "error", found, "the driver must stamp every cloud anew; pairs are made by stamp")]
    told = [stamp for stamp in stamps_ns if stamp]
    findings = _check_order(np.array(told, np.int64))
    if missing := len(stamps_ns) - len(told):
        advice = "clouds without a stamp cannot be paired: mend the driver, or leave them out"
        findings.append(Finding("stamps of zero", "warn", f"{missing} of {len(stamps_ns)} clouds", advice))
    return findings


def check_bag_times(stamps_ns: Sequence[int], bag_times_ns: Sequence[int]) -> list[Finding]:
    """Compare stamps [ns] with the times of recording [ns]; nothing to be said of stamps that are zero."""
    delays = [at - stamp for stamp, at in zip(stamps_ns, bag_times_ns, strict=True) if stamp]
    return [_check_clocks(np.array(delays, np.int64))] if delays else []


def _check_order(stamps: NDArray[np.int64]) -> list[Finding]:
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    rate = f", {1e9 / np.median(forward):.1f} Hz" if len(forward) else ""
    span = f"{text_from_ns(int(stamps.min()))} to {text_from_ns(int(stamps.max()))} s{rate}"
    findings = [Finding("stamps", "ok", span)]
    if backwards := int((steps < 0).sum()):
        advice = "a backwards jump clears pairing; check clocks, or split the bag there"
        findings.append(Finding("stamp order", "warn", f"{backwards} backwards", advice))
    if repeated := len(stamps) - len(np.unique(stamps)):
        advice = "scans with one stamp cannot be told apart"
        findings.append(Finding("stamp repeats", "warn", f"{repeated} duplicates", advice))
    if len(forward) and (gaps := int((forward > _GAP_FACTOR * np.median(forward)).sum())):
        longest = f"{gaps} gaps, the longest {forward.max() / 1e9:.3f} s"
        findings.append(Finding("stamp gaps", "warn", longest, "scans are missing: disk, network or driver too slow"))
    return findings


def _check_clocks(delays_ns: NDArray[np.int64]) -> Finding:
    delay = delays_ns / 1e9
    middle, spread = float(np.median(delay)), float(delay.max() - delay.min())
    found = f"recorded {middle:+.3f} s after the header's stamp (spread {spread:.3f} s)"
    if abs(middle) <= _CLOCK_S and spread <= _CLOCK_S:
        return Finding("header and bag time", "ok", found)
    advice = "different clocks: transforms may not exist at the header's stamp"
    return Finding("header and bag time", "warn", found, advice)
